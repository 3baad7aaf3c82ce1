"""A claim of the paper as a row: its words, its number, what was published with it, and what our runs give."""

from collections.abc import Sequence
from dataclasses import dataclass

from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.report.case_data import CaseDecision, CaseRun
from sumo_hmdp.report.case_numbers import least_distance, least_distance_at_ends

MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class Row:
    """One claim.

    Attributes:
        claim: the paper's words, in short.
        paper: its number, empty where it gives none.
        published: the number of its authors' published code, empty where there is none.
        ours: from our runs.
        difference: ours less the published one, or less the paper's; or whether the claim holds.
        why: the reason for a difference, empty where there is nothing to explain.
    """

    claim: str
    paper: str
    published: str
    ours: str
    difference: str
    why: str = ""


def number(
    claim: str,
    ours: float | None,
    unit: str,
    *,
    paper: float | None = None,
    published: float | None = None,
    about: bool = False,
    digits: int = 1,
    why: str = "",
) -> Row:
    """Return the row of a number; the difference is to what was published, or else to the paper."""
    reference = published if published is not None else paper
    difference = (
        f"{told(ours - reference, digits, sign=True)} {unit}" if ours is not None and reference is not None else ""
    )
    paper_told = "" if paper is None else f"{'about ' if about else ''}{told(paper, 0 if about else digits)} {unit}"
    published_told = "" if published is None else f"{told(published, digits)} {unit}"
    return Row(claim, paper_told, published_told, f"{told(ours, digits)} {unit}", difference, why)


def statement(claim: str, ours: str, *, holds: bool, why: str = "") -> Row:
    """Return the row of a claim in words."""
    return Row(claim, "", "", ours, "holds" if holds else "does not hold", why)


def told(value: float | None, digits: int = 1, *, sign: bool = False) -> str:
    """Return a number as in the document: fixed decimals and a real minus; a value that is not defined is `never`."""
    if value is None:
        return "never"
    text = f"{value:+.{digits}f}" if sign else f"{value:.{digits}f}"
    # What rounds to nothing has no sign.
    text = text.lstrip("+-") if float(text) == 0 else text
    return text.replace("-", MINUS)


def changes_told(decisions: Sequence[CaseDecision]) -> str:
    """Return lane changes in words."""
    words = {Lateral.LEFT: "left", Lateral.RIGHT: "right"}
    return ", ".join(f"{words[Lateral(d.lateral)]} at {d.time:.2f} s" for d in decisions) or "none"


def distance_row(run: CaseRun, claim: str) -> Row:
    """Return the row of a claim that the safe distance is kept."""
    distance, ends, always = run.safe_distance or 0.0, least_distance_at_ends(run), least_distance(run)
    return statement(
        f"{claim} ({distance:g} m)",
        f"least distance to a vehicle in the lane that it intends: {told(ends, 2)} m at the ends of steps, "
        f"{told(always, 2)} m at any time",
        holds=ends >= distance,
        why=""
        if always >= distance
        else "The constraint holds at the ends of steps. In the step that begins a lane change a vehicle in the new "
        "lane may be nearer, until the end of it.",
    )
