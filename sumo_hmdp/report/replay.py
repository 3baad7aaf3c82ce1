"""One run as one HTML page that plays in any browser, without a server, a network or a library."""

import base64
import json
import os
import zlib
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from sumo_hmdp.report.replay_data import replay_data
from sumo_hmdp.report.replay_summary import summarize
from sumo_hmdp.report.short import uncovered_of_run

if TYPE_CHECKING:
    import pandas as pd

_STYLES = ("replay.css",)
# In the order of use: later files call earlier ones. They share one scope in the page.
_SCRIPTS = (
    "unpack.js",
    "replay_data.js",
    "replay_ink.js",
    "replay_road.js",
    "replay_vehicles.js",
    "replay_plots.js",
    "replay_bounds.js",
    "replay_risk.js",
    "replay_actions.js",
    "replay_notes.js",
    "replay_timeline.js",
    "replay_panel.js",
    "replay_app.js",
)
_HEADLINE_KEYS = ("scenario", "planner", "seed", "status", "reason")
_GOOD_STATUSES = {"completed", "complete", "finished", "ok", "success"}
_BAD_STATUSES = {"collision", "contact", "crashed", "error", "failed", "off_road"}


def render_replay(manifest: dict[str, Any], steps: "pd.DataFrame", decisions: "pd.DataFrame") -> str:
    """Render the replay page of one run.

    Positions in the page are the recorded ones, rounded to the millimetre; the page interpolates only between
    recorded instants. `page.html#t=12.6` opens at 12.6 s.

    Args:
        manifest: the run's manifest; `lanes` must hold `count` and `width_m` [m], the rest is optional.
        steps: one row per recorded instant and vehicle.
        decisions: one row per decision, may be empty.

    Returns:
        The page, one self-contained HTML document.

    Raises:
        InputError: a column or the road is missing, or a JSON column cannot be read.
    """
    data = replay_data(manifest, steps, decisions)
    summary = summarize(data)
    data["lane_changes"] = [{"time_s": time, "lane": lane, "left": left} for time, lane, left in summary.lane_changes]
    status = str(manifest.get("status") or "unknown")
    template = _environment().get_template("replay.html.j2")
    return template.render(
        run={key: manifest.get(key) for key in ("run_id", "dt_s", "period_s", "duration_s", *_HEADLINE_KEYS)},
        status=status,
        tone=_tone(status),
        summary=summary,
        has_steps=bool(data["times_s"]),
        has_decisions=bool(data["decisions"]),
        uncovered=uncovered_of_run(manifest, [d["pruned_prob"] or 0.0 for d in data["decisions"]]),
        parameters=[row for row in _flat(manifest) if row[0] not in _HEADLINE_KEYS],
        data=_embedded(data),
        styles=_asset(_STYLES),
        scripts=_asset(_SCRIPTS),
    )


def write_replay(
    path: str | os.PathLike[str], manifest: dict[str, Any], steps: "pd.DataFrame", decisions: "pd.DataFrame"
) -> Path:
    """Write the replay page of one run; the file appears complete or not at all.

    Args:
        path: of the HTML file; its folder is made if it does not exist.
        manifest: as for `render_replay`.
        steps: as for `render_replay`.
        decisions: as for `render_replay`.

    Returns:
        The path of the file.

    Raises:
        InputError: as for `render_replay`.
    """
    target = Path(path)
    page = render_replay(manifest, steps, decisions)
    target.parent.mkdir(parents=True, exist_ok=True)
    draft = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        draft.write_text(page, encoding="utf-8", newline="\n")
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)
    return target


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("sumo_hmdp.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["fixed"] = _fixed
    return environment


def _asset(names: tuple[str, ...]) -> Markup:
    folder = resources.files("sumo_hmdp.report") / "templates"
    # Our own files, not anybody's data.
    return Markup("\n".join((folder / name).read_text(encoding="utf-8") for name in names))  # noqa: S704


def packed(text: str) -> Markup:
    """Return a text as Base64 of its zlib stream: a tenth of the size, and no HTML parser can leave it."""
    # Base64 has no character that means anything to HTML.
    return Markup(base64.b64encode(zlib.compress(text.encode("utf-8"), 9)).decode("ascii"))  # noqa: S704


def _embedded(data: Mapping[str, Any]) -> Markup:
    return packed(json.dumps(data, allow_nan=False, ensure_ascii=True, separators=(",", ":")))


def _flat(value: object, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield every leaf of a nested mapping with its dotted path; short lists stay on one line."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(inner, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple) and any(isinstance(inner, Mapping | list | tuple) for inner in value):
        for position, inner in enumerate(value):
            yield from _flat(inner, f"{path}[{position}]")
    elif isinstance(value, list | tuple):
        yield path, ", ".join(str(inner) for inner in value)
    else:
        yield path, "none" if value is None else str(value)


def _fixed(value: object, decimals: int = 1) -> str:
    """Format a number with a fixed count of decimals, a missing one as a dash."""
    return f"{value:.{decimals}f}" if isinstance(value, int | float) else "–"  # noqa: RUF001 - the dash of tables


def _tone(status: str) -> str:
    word = status.lower()
    if word in _GOOD_STATUSES:
        return "good"
    return "bad" if word in _BAD_STATUSES else "plain"
