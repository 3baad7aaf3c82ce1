"""The replays that a study's report carries in itself: the first of the runs to look at, as far as they are cheap."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.report.replay import packed, render_replay
from sumo_hmdp.study.again import StoredRun, keeps_all, stored_run, whole_run

# How many replays, and how large they may be in all: the whole report has to stay below 10 MB.
COUNT, BYTES = 5, 6_000_000
# Runs whose steps were not stored are done again as long as they took no longer than this in all, by what the table
# `runs` says: no clock, so that the same folder gives the same page [s].
AGAIN = 8.0


@dataclass(frozen=True)
class StudyReplay:
    """One replay page inside a report.

    Attributes:
        run_id: of the run.
        page: the whole page, packed.
        repeated: whether the run was done again for it.
    """

    run_id: str
    page: Markup
    repeated: bool


@dataclass(frozen=True)
class StudyReplays:
    """The replays of a report.

    Attributes:
        pages: in the order of the runs.
        notes: what a reader has to know of them, in sentences.
    """

    pages: tuple[StudyReplay, ...]
    notes: tuple[str, ...]

    @property
    def run_ids(self) -> frozenset[str]:
        """The runs that open in the report."""
        return frozenset(page.run_id for page in self.pages)


def study_replays(folder: Path, run_ids: Iterable[str], on_run: Callable[[], None] = lambda: None) -> StudyReplays:
    """Make the replays of the first runs.

    Args:
        folder: the study's.
        run_ids: the runs to look at, the first one first.
        on_run: called as each is begun.
    """
    pages: list[StudyReplay] = []
    left_out: list[str] = []
    size, spent = 0, 0.0
    for run_id in list(run_ids)[:COUNT]:
        on_run()
        run = stored_run(folder, run_id)
        again = 0.0 if keeps_all(run.table("steps")) else float(run.row.get("wall_time_s", float("nan")))
        # A missing time compares as false.
        if not spent + again <= AGAIN:
            left_out.append(f"{run_id} is not here, since doing it again takes too long for a report.")
            continue
        spent += again
        try:
            page = _page(run, explained=again > 0.0)
        except SumoHmdpError as error:
            left_out.append(f"{run_id} is not here: {error}")
            continue
        if size + len(page.page) > BYTES:
            left_out.append(f"{run_id} is not here, since its replay of {len(page.page) / 1e6:.1f} MB is too large.")
            continue
        size += len(page.page)
        pages.append(page)
    return StudyReplays(tuple(pages), (*_told(pages), *left_out))


def _page(run: StoredRun, *, explained: bool) -> StudyReplay:
    # Where it has to be done again, the other first actions cost little more.
    whole = whole_run(run, explained=explained)
    page = render_replay(dict(whole.manifest), whole.steps, whole.decisions)
    return StudyReplay(run.run_id, packed(page), whole.repeated)


def _told(pages: list[StudyReplay]) -> Iterator[str]:
    if not pages:
        return
    yield "Runs whose names are links open their replay here; the command shows any run of the study."
    repeated = sum(page.repeated for page in pages)
    if repeated:
        those = "These runs were" if repeated == len(pages) else f"{repeated} of these runs were"
        yield (
            f"{those} done again for this page, as the study kept no steps of the other vehicles; they are the same, "
            "bit for bit. Their solve times are those of the study."
        )
