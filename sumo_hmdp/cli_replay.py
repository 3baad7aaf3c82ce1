"""The commands that show one stored run: `sumo-hmdp replay`, `sumo-hmdp video`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sumo_hmdp.cli_common import RUNS, complete_run, progress_bar, say, tell
from sumo_hmdp.errors import InputError

if TYPE_CHECKING:
    from sumo_hmdp.study.again import WholeRun


def add_commands(app: typer.Typer) -> None:
    """Add the commands of this file to the command line."""
    app.command(rich_help_panel=RUNS)(replay)
    app.command(rich_help_panel=RUNS)(video)


FolderArgument = Annotated[Path, typer.Argument(help="A results directory.", show_default=False)]
RunArgument = Annotated[
    str,
    typer.Argument(help="A run in it, as in the table `runs`.", show_default=False, autocompletion=complete_run),
]


def replay(
    folder: FolderArgument,
    run_id: RunArgument,
    out: Annotated[Path | None, typer.Option(help="The HTML file; without it `replays/RUN_ID.html` in DIR.")] = None,
    open_page: Annotated[  # noqa: FBT002 - a flag of the command line
        bool, typer.Option("--open", help="Open the page in the browser.")
    ] = False,
) -> None:
    """Write the page that replays a run of a results directory or a study.

    What was stored is shown. The run is done again from its description, to say of each decision why no other first
    action was taken; where the study kept no other vehicles (`trace: none` or `ego`), to show it at all. That counts
    only if it is the same bit for bit.

    Example: `sumo-hmdp replay results/main highway-hmdp_mpc-search-eps0.1-0123456789-seed3 --open`
    """
    from sumo_hmdp.report.replay import write_replay

    page = folder / "replays" / f"{run_id}.html" if out is None else out
    if page.suffix.lower() not in {".html", ".htm"}:
        raise InputError([f"--out: must end in .html, got {str(page)!r}. Name a file such as replay.html"])
    run = _whole_run(folder, run_id, explained=True)
    if run.untold:
        say(f"the page does not say why other first actions were not taken: {run.untold}", typer.colors.YELLOW)
    try:
        write_replay(page, dict(run.manifest), run.steps, run.decisions)
    except OSError as error:
        raise InputError([f"--out: {page} cannot be written: {error.strerror}. Choose another"]) from None
    tell(f"page: {page}{_origin(run)}")
    if open_page and not webbrowser.open(page.resolve().as_uri()):
        say("--open: no browser was found here; open the page by hand", typer.colors.YELLOW)


def video(
    folder: FolderArgument,
    run_id: RunArgument,
    out: Annotated[Path, typer.Argument(help="The film: .mp4 or .gif.", show_default=False)],
    speed: Annotated[float, typer.Option(help="How many seconds of the run a second of the film shows.")] = 1.0,
    fps: Annotated[float | None, typer.Option(help="Frames a second; without it 25, and 10 for a GIF.")] = None,
    width: Annotated[int | None, typer.Option(help="Width in pixels; without it 1280, and 800 for a GIF.")] = None,
) -> None:
    """Film a run from above, without a display; its speeds and decisions are below the road.

    MP4 needs PyAV: `pip install "sumo-hmdp[video]"`.

    Example: `sumo-hmdp video results case2-hmdp_mpc-eps0.05-seed0 case2.mp4 --speed 2`
    """
    from sumo_hmdp.report.film import film_of
    from sumo_hmdp.report.video import write_film
    from sumo_hmdp.report.video_file import film_format

    made = film_format(out, speed, fps, width)
    run = _whole_run(folder, run_id)
    film = film_of(run.manifest, run.steps, run.decisions, made)
    with progress_bar("frames") as on_progress:
        write_film(out, film, on_progress)
    tell(f"film: {out}, {film.frame_count} frames, {film.frame_count / made.fps:.1f} s{_origin(run)}")


def _origin(run: "WholeRun") -> str:
    return "    (done again from its description: the same, bit for bit)" if run.repeated else ""


def _whole_run(folder: Path, run_id: str, *, explained: bool = False) -> "WholeRun":
    from sumo_hmdp.sim.episode import Moment
    from sumo_hmdp.study.again import stored_run, whole_run

    run = stored_run(folder, run_id)
    duration = float(run.manifest()["duration_s"])
    with progress_bar("doing the run again") as on_progress:

        def on_moment(moment: Moment) -> None:
            on_progress(moment.scene.time, duration)

        return whole_run(run, on_moment, explained=explained)
