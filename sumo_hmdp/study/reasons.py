"""Why no other first action was taken: kept while a run goes on, worked out for its replay. No table holds it."""

import json
from dataclasses import dataclass, field

import pandas as pd

from sumo_hmdp.domain.plan import Decision, TriedAction, WeighsActions
from sumo_hmdp.sim.episode import Moment

COLUMN = "actions_json"


@dataclass
class Reasons:
    """The decisions of a run, each with what it rests on.

    Attributes:
        decisions: in their order.
    """

    decisions: list[Decision] = field(default_factory=list)

    def observe(self, moment: Moment) -> None:
        """Take an instant in."""
        if moment.decision is not None:
            self.decisions.append(moment.decision)

    def beside(self, table: pd.DataFrame) -> pd.DataFrame:
        """Return the table of the same decisions with the column `actions_json`: a JSON list, empty where nobody says.

        It takes about as long as it took to decide.
        """
        taken = self.decisions[: len(table)]
        return table.assign(**{COLUMN: [_row(decision) for decision in taken]}) if len(table) else table


def _row(decision: Decision) -> str:
    evidence = decision.evidence
    tried: tuple[TriedAction, ...] = evidence.tried() if isinstance(evidence, WeighsActions) else ()
    return json.dumps(
        [
            {
                "lateral": action.lateral.label,
                "mode": action.mode.label,
                "chosen": action.chosen,
                "verdict": action.verdict,
                "reason": action.reason,
                "objective": action.objective,
                "violation_m": action.violation,
                "risk": action.risk,
            }
            for action in tried
        ]
    )
