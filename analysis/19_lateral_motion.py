"""How the highway's traffic moves across the road, against what is predicted of it.

Drives through `highway` with an ego that decides nothing, on seeds that no test uses. Prints how much vehicles leave
the centre of their lane while they keep it, how exactly a step of a lane change is predicted, and the mean error of y
after the horizon for vehicles in the middle of a lane change: by the paper's law, and by that of lane changes that take
their time.

    python analysis/19_lateral_motion.py --first 101 --seeds 4
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, VehicleState
from sumo_hmdp.prediction.dynamics import LateralGains, Noise
from sumo_hmdp.prediction.lateral import LaneFollowing, forecast
from sumo_hmdp.prediction.reading import read_maneuver
from sumo_hmdp.scenario.load import RunOptions, load_scenario
from sumo_hmdp.study.run import execute

SCENARIO = Path(__file__).parents[1] / "scenarios" / "highway.yaml"
# As in the scenario: the step, the period in steps, the horizon in periods, and the modes' acceleration [m/s2].
DT, PERIOD, HORIZON, ACCEL = 0.2, 4, 6, 2.0
KEEP = np.zeros((1, HORIZON), dtype=np.int64)
# Who is farther from the centre of the lane that it is in has begun a change or is ending one [m].
OFF_CENTER = 0.05


def main() -> None:
    """Print the measures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=101, help="first seed")
    parser.add_argument("--seeds", type=int, default=4, help="how many")
    parser.add_argument("--duration", type=float, default=60.0, help="of a run [s]")
    options = parser.parse_args()
    kept: list[float] = []
    errors: list[tuple[float, float, float]] = []
    for seed in range(options.first, options.first + options.seeds):
        overrides = {"duration_s": options.duration}
        ready = load_scenario(SCENARIO, RunOptions(planner="constant", seed=seed, overrides=overrides))
        steps = execute(ready).steps
        for _, track in steps[steps["vehicle_id"] != EGO_ID].groupby("vehicle_id"):
            measure(track, ready.episode.road, kept, errors)
    step, paper, ours = np.array(errors).T
    print(f"keeping their lane: {len(kept)} instants, standard deviation of y {np.std(kept):.4f} m")
    print(f"changing lanes: {len(errors)} instants, variance of the error of one step {np.var(step):.5f} m2")
    horizon = PERIOD * HORIZON * DT
    print(
        f"mean error of y after {horizon:.1f} s: {paper.mean():.3f} m by the paper's law, {ours.mean():.3f} m by ours"
    )


def measure(track: pd.DataFrame, road: Road, kept: list[float], errors: list[tuple[float, float, float]]) -> None:
    """Add what one vehicle did: deviations while it keeps its lane, errors in the middle of lane changes."""
    time, y = track["time_s"].to_numpy(), track["y_m"].to_numpy()
    last = None
    for i in range(1, len(y) - PERIOD * HORIZON):
        # A vehicle that was out of sight in between is left out.
        if abs(time[i + PERIOD * HORIZON] - time[i - 1] - (PERIOD * HORIZON + 1) * DT) > DT / 2:
            continue
        lateral_speed = (y[i] - y[i - 1]) / DT
        state = VehicleState("other", x=0.0, y=y[i], speed=20.0, lane=road.lane_at(y[i]), lateral_speed=lateral_speed)
        last = read_maneuver(state, road, ACCEL, last)
        deviation = y[i] - road.center_y(state.lane)
        if abs(deviation) <= OFF_CENTER:
            kept.append(deviation)
            continue
        seen = VehicleState("other", x=0.0, y=y[i], speed=20.0, lane=last.lane, lateral_speed=lateral_speed)
        period = PERIOD * DT
        ours = forecast(seen, Noise(), LaneFollowing(), road, KEEP, period).y[0]
        paper = forecast(seen, Noise(), LaneFollowing(), road, KEEP, period, LateralGains()).y[0]
        end = y[i + PERIOD * HORIZON]
        errors.append((ours[1] - y[i + PERIOD], abs(paper[-1] - end), abs(ours[-1] - end)))


if __name__ == "__main__":
    main()
