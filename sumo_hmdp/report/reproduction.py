"""The page that sets the paper's claims against our runs, as Markdown."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined

from sumo_hmdp.report.case2_rows import case2_rows, rule_rows
from sumo_hmdp.report.case3_figures import moment, place
from sumo_hmdp.report.case_claims import told
from sumo_hmdp.report.case_data import CaseRun
from sumo_hmdp.report.case_fit import Published, demands, distance, fitted_values, published_numbers
from sumo_hmdp.report.case_instants import Instant, case1_instants, case2_readings
from sumo_hmdp.report.case_rows import case1_rows, case3_rows, joint_rows, lateral_rows


@dataclass(frozen=True)
class PaperRuns:
    """All runs of the paper's cases.

    Attributes:
        case1: Case 1.
        case1_literal: the same with the paper's cost alone.
        case1_fitted: with the open values fitted to all published numbers.
        case2: Case 2 under the proposed planner.
        case2_literal: the same with the paper's cost alone.
        case2_fitted: with the open values fitted to all published numbers.
        case2_slower: with a slower SV1 and a slower ego, found by hand.
        rule_based: Case 2 under the rules.
        case3: Case 3, one run for each risk level that is compared, the smallest first.
        case3_more: all runs of Case 3, the smallest risk level first.
    """

    case1: CaseRun
    case1_literal: CaseRun
    case1_fitted: CaseRun
    case2: CaseRun
    case2_literal: CaseRun
    case2_fitted: CaseRun
    case2_slower: CaseRun
    rule_based: CaseRun
    case3: Sequence[CaseRun]
    case3_more: Sequence[CaseRun]


@dataclass(frozen=True)
class Fit:
    """A case and its fitted setting against the paper's instants and places, as text.

    Attributes:
        names: of both scenarios.
        rows: (snapshot, what happens, ours, difference, what ours does then, fitted, difference, what it does then).
        places: (what, paper, ours, difference, fitted, difference).
        values: (path, the case's, the fitted one).
        distances: of both.
        missed: what the fitted setting does not meet within one scale.
    """

    names: tuple[str, str]
    rows: Sequence[Sequence[str]]
    places: Sequence[Sequence[str]]
    values: Sequence[tuple[str, object, object]]
    distances: tuple[str, str]
    missed: str

    @classmethod
    def of(cls, case: int, run: CaseRun, fitted: CaseRun) -> "Fit":
        """Compare a case and its fitted setting with the paper."""
        numbers = published_numbers(case, fitted)
        missed = [f"{one.what} by {told(one.off)} scales" for one in numbers if one.off > 1]
        missed += [f"{what} does not hold" for what, holds in demands(case, fitted) if not holds]
        return cls(
            names=(run.name, fitted.name),
            rows=[
                _instant_row(a, b) for a, b in zip(_all_instants(case, run), _all_instants(case, fitted), strict=True)
            ],
            places=[
                _place_row(a, b)
                for a, b in zip(published_numbers(case, run), numbers, strict=True)
                if b.what.endswith("[m]")
            ],
            values=fitted_values(run, fitted),
            distances=(told(distance(case, run), 2), told(distance(case, fitted), 2)),
            missed="; ".join(missed) or "nothing",
        )


def _all_instants(case: int, run: CaseRun) -> tuple[Instant, ...]:
    """Return all instants; of Case 2 the last two by both readings."""
    if case == 1:
        return case1_instants(run)
    early, late = case2_readings(run).values()
    return (*early, *late[-2:])


def _instant_row(ours: Instant, fitted: Instant) -> list[str]:
    cells = [f"({ours.label}) {told(ours.paper, 2)} s", ours.what]
    for one in (ours, fitted):
        off = told(one.ours - one.paper, 2, sign=True) + " s" if one.ours is not None else "does not happen"
        when = "never" if one.ours is None else f"{told(one.ours, 2)} s"
        cells += [when, off, one.there]
    return cells


def _place_row(ours: Published, fitted: Published) -> list[str]:
    cells = [ours.what.removesuffix(" [m]"), f"about {told(ours.paper, 0)} m"]
    for one in (ours, fitted):
        assert one.ours is not None  # noqa: S101 - everybody is somewhere after 45 s
        cells += [f"{told(one.ours)} m", f"{told(one.ours - one.paper, sign=True)} m"]
    return cells


def render_reproduction(runs: PaperRuns, versions: Mapping[str, str]) -> str:
    """Render the page.

    Args:
        runs: of all cases.
        versions: of what the runs were made with.

    Returns:
        Markdown that names the figures as `figures/NAME.png` and `.svg`.
    """
    environment = Environment(  # noqa: S701 - Markdown, of our own numbers
        loader=PackageLoader("sumo_hmdp.report"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    page = environment.get_template("reproduction.md.j2").render(
        run_count=8 + len(runs.case3_more),
        sumo=versions["sumo"],
        highs=versions["highs"],
        case1=list(case1_rows(runs.case1, runs.case1_literal)),
        fit1=Fit.of(1, runs.case1, runs.case1_fitted),
        slower=_slower(runs.case2_slower),
        fit2=Fit.of(2, runs.case2, runs.case2_fitted),
        case2=list(case2_rows(runs.case2, runs.case2_literal)),
        rules=list(rule_rows(runs.rule_based, runs.case2)),
        case3=list(case3_rows(runs.case3, runs.case3_more)),
        levels=[_level(run) for run in runs.case3],
        joint=list(
            joint_rows(
                [("Case 1", runs.case1), *((f"Case 3, risk level {run.risk_level:g}", run) for run in runs.case3)]
            )
        ),
        lateral=list(lateral_rows(runs.case2)),
    )
    # Macros leave more blank lines than Markdown needs.
    return re.sub(r"\n{3,}", "\n\n", page).rstrip() + "\n"


def _slower(run: CaseRun) -> str:
    """Tell what Case 2 gives with a slower SV1 and a slower ego, in one sentence."""
    *first, out = case2_readings(run)["late"]
    places = ", ".join(
        f"{one.what.removesuffix(' [m]')} {told(one.ours, 0)} m" for one in published_numbers(2, run)[-2:]
    )
    events = "; ".join(f"{one.what}: {told(one.ours)} s (paper {told(one.paper, 2)} s)" for one in (*first[:4], out))
    held = "all decisions are optimal" if all(holds for _, holds in demands(2, run)) else "not all demands hold"
    top, wanted = run.vehicle_file("sv1")["driver"]["speed_max_mps"], run.parameters["desired_speed_mps"]
    return (
        f"With SV1's top speed {top:g} m/s, a desired speed of {wanted:g} m/s and all else as in `case2`: {places}; "
        f"{events}; {held}. Its distance is {told(distance(2, run), 2)}."
    )


def _level(run: CaseRun) -> dict[str, str]:
    changed = moment(run) if run.changes() else None
    x = place(run) if run.changes() else None
    sv1 = run.motions["sv1"]
    behind = float(sv1.x[sv1.index(changed)]) - x if changed is not None and x is not None else None
    touched = f"contact at {run.ego.times[-1]:.2f} s" if run.row["contact_count"] else str(run.row["status"])
    return {
        "risk_level": f"{run.risk_level:g}",
        "time_s": told(changed, 2),
        "x_m": told(x, 1),
        "behind_m": told(behind, 2),
        "gap_min_m": told(run.row["gap_min_m"], 2),
        "end": touched,
    }
