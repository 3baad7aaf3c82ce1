"""The page that sets the paper's claims against our runs, as Markdown."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined

from sumo_hmdp.report.case2_rows import case2_rows, rule_rows
from sumo_hmdp.report.case3_figures import moment, place
from sumo_hmdp.report.case_claims import told
from sumo_hmdp.report.case_data import CaseRun
from sumo_hmdp.report.case_rows import case1_rows, case3_rows, joint_rows, lateral_rows


@dataclass(frozen=True)
class PaperRuns:
    """All runs of the paper's cases.

    Attributes:
        case1: Case 1.
        case1_literal: the same with the paper's cost alone.
        case2: Case 2 under the proposed planner.
        case2_literal: the same with the paper's cost alone.
        rule_based: Case 2 under the rules.
        case3: Case 3, one run for each risk level that is compared, the smallest first.
        case3_more: all runs of Case 3, the smallest risk level first.
    """

    case1: CaseRun
    case1_literal: CaseRun
    case2: CaseRun
    case2_literal: CaseRun
    rule_based: CaseRun
    case3: Sequence[CaseRun]
    case3_more: Sequence[CaseRun]


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
        run_count=5 + len(runs.case3_more),
        sumo=versions["sumo"],
        highs=versions["highs"],
        case1=list(case1_rows(runs.case1, runs.case1_literal)),
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
