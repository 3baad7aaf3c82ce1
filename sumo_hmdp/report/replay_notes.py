"""A decision's notes as the replay page shows them: a table of the lanes, and words for everything else."""

import json
import math
import re
from typing import Any

NOTES = "notes_json"
_LANE = re.compile(r"lane_(\d+)_(.+)")
# What names end in, and how it is written.
_UNITS = {
    "mps2": "m/s\N{SUPERSCRIPT TWO}", "mps": "m/s", "m": "m", "s": "s", "ms": "ms", "rad": "rad", "vpkm": "veh/km",
}  # fmt: skip
_WORDS = {"accel": "acceleration", "decel": "deceleration", "prob": "probability"}


def notes_of(text: object) -> tuple[dict[str, Any], str]:
    """Return the notes in a JSON column as the page shows them, and what is wrong with the column, if anything.

    Returns:
        `columns` and `lanes`, the table of what is noted lane by lane (lane numbers with a text for each column), and
        `others`, pairs of a name and a text; and the problem, empty where there is none. Numbers have three decimals.
    """
    empty: dict[str, Any] = {"columns": [], "lanes": [], "others": []}
    if not isinstance(text, str) or not text.strip():
        return empty, ""
    try:
        notes = json.loads(text)
    except json.JSONDecodeError as error:
        return empty, f"must hold JSON, got {text[:40]!r} ({error}). Pass the table as the run wrote it."
    if not isinstance(notes, dict):
        return empty, f"must hold names with values, got {text[:40]!r}. Pass the table as the run wrote it."
    by_lane: dict[int, dict[str, str]] = {}
    others = []
    for name, value in notes.items():
        lane = _LANE.fullmatch(name)
        if lane is None:
            others.append([worded(name), _shown(value)])
        else:
            by_lane.setdefault(int(lane[1]), {})[lane[2]] = _shown(value)
    columns = list(dict.fromkeys(name for cells in by_lane.values() for name in cells))
    lanes = [[lane, [by_lane[lane].get(name, "") for name in columns]] for lane in sorted(by_lane)]
    return {"columns": [worded(name) for name in columns], "lanes": lanes, "others": others}, ""


def worded(name: str) -> str:
    """Return a name in words: `accel_mps2` is `acceleration (m/s2)` with a raised 2."""
    *words, last = name.split("_")
    unit = _UNITS.get(last) if words else None
    words = words if unit else [*words, last]
    text = " ".join(_WORDS.get(word, word) for word in words)
    return f"{text} ({unit})" if unit else text


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float) and math.isfinite(value):
        # Adding 0 takes the sign off what rounds to nothing.
        return f"{round(value, 3) + 0.0:.10g}"
    return str(value)
