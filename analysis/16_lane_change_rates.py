"""How often vehicles start a lane change, by the incentive that the planner sees for it: the rates of its belief.

Reads recorded runs of `highway` with seeds that no study and no test uses, weighs every change of every vehicle
within 200 m of the ego by the planner's own IDM and MOBIL (`decision/lane_change_belief.py`), and counts the changes
that begin within the next period of 0.8 s. The first 4 s are left out: nobody changes lanes at the end of the warm-up.

    python analysis/16_lane_change_rates.py RESULTS      # a study folder with `trace: all`
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

import sumo_hmdp
from sumo_hmdp.decision.lane_change_belief import incentive_levels
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, VehicleState

ROAD, STEPS_A_PERIOD, LEVELS = Road(3, 4.0), 4, ("unsafe", "unwanted", "undecided", "wanted")
DENSITY = "traffic.density_vpkm_per_lane"


def states(table: pd.DataFrame) -> list[VehicleState]:
    """Return the vehicles of one instant."""
    return [
        VehicleState(
            row.vehicle_id,
            row.x_m,
            row.y_m,
            row.speed_mps,
            int(row.intended_lane),
            Mode.CRUISE,
            length=row.length_m,
            width=row.width_m,
        )
        for row in table.itertuples()
    ]


def chances(run: pd.DataFrame) -> Iterator[tuple[int, bool]]:
    """Yield for every vehicle, period and side the level of the incentive, and whether a change began."""
    instants = dict(tuple(run.groupby("step")))
    for step in range(5 * STEPS_A_PERIOD, max(instants) - STEPS_A_PERIOD, STEPS_A_PERIOD):
        now = states(instants[step])
        later = instants[step + STEPS_A_PERIOD].set_index("vehicle_id")["intended_lane"]
        ego = next(state for state in now if state.id == EGO_ID)
        others = [state for state in now if state.id != EGO_ID]
        levels = incentive_levels(ROAD, others, [state.lane for state in others], ego)
        for state, level in zip(others, levels, strict=True):
            changing = ROAD.lane_at(state.y) != state.lane
            if changing or abs(state.x - ego.x) > 200.0 or state.id not in later.index:
                continue
            for side in (0, 1):
                lane = state.lane + 2 * side - 1
                if ROAD.has_lane(lane):
                    yield int(level[side]), bool(later[state.id] == lane)


def main() -> None:
    """Print how often lane changes begin, by density and incentive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    results = sumo_hmdp.load(parser.parse_args().results)
    density = dict(zip(results.runs["run_id"], results.runs[DENSITY], strict=True))
    rows = [
        (density[run_id], level, began)
        for run_id, run in results.steps.groupby("run_id")
        for level, began in chances(run)
    ]
    found = pd.DataFrame(rows, columns=["density", "level", "began"])
    found["incentive"] = np.array(LEVELS)[found["level"]]
    for name, group in [*found.groupby("density"), ("15 and 25", found[found["density"] < 30])]:
        counted = group.groupby("incentive")["began"].agg(["sum", "count", "mean"]).reindex(LEVELS)
        print(f"density {name}\n{counted.to_string()}\n")


if __name__ == "__main__":
    main()
