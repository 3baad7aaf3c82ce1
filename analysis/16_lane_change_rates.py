"""How often vehicles start a lane change, by the incentive that the planner sees for it: the rates of its belief.

Reads recorded runs with seeds that no study and no test uses, weighs every change of every vehicle within 200 m of the
ego by the planner's own IDM and MOBIL (`decision/lane_change_belief.py`), and counts the changes that begin within the
planner's next period. The first five periods are left out: nobody changes lanes at the end of the warm-up. Then it
counts how often modes are seen one period later, and fits the noise of a period so that the variance of positions is
right at every step of the horizon: what a prediction leaves over is far from white, and the noise that one period
leaves over gives a quarter of the variance that six leave.

    python analysis/16_lane_change_rates.py RESULTS      # a study folder of one scenario with `trace: all`
"""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import nnls

import sumo_hmdp
from sumo_hmdp.decision.lane_change_belief import incentive_levels
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, VehicleState

LEVELS = ("unsafe", "unwanted", "undecided", "wanted")
DENSITY = "traffic.density_vpkm_per_lane"
NEAR = 200.0
# As in `prediction/reading.py`: a mode is read beyond this share of its acceleration.
READ = 0.6
MOVING = 0.5


@dataclass(frozen=True)
class World:
    """What the planner of a recorded study is set to: its road, periods and horizon, and the lanes that end."""

    road: Road
    steps: int
    period: float
    horizon: float
    accel: float
    ending: tuple[int, ...]

    @staticmethod
    def of(manifest: Mapping[str, Any]) -> "World":
        """Read it from the manifest of a run."""
        scenario = manifest["document"]
        planner = scenario["planners"]["hmdp_mpc"]
        rates = scenario["traffic"]["belief"].get("lane_change_rates") or {}
        return World(
            Road(scenario["lanes"]["count"], scenario["lanes"]["width_m"]),
            round(planner["period_s"] / scenario["dt_s"]),
            planner["period_s"],
            planner["period_s"] * planner["horizon_steps"],
            planner["accel_mps2"],
            tuple(rates.get("ending_lanes", ())),
        )


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


def chances(run: pd.DataFrame, world: World) -> Iterator[tuple[str, bool]]:
    """Yield for every vehicle, period and side the kind of its rate, and whether a change began."""
    instants = dict(tuple(run.groupby("step")))
    for step in range(5 * world.steps, max(instants) - world.steps, world.steps):
        now = states(instants[step])
        later = instants[step + world.steps].set_index("vehicle_id")["intended_lane"]
        ego = next(state for state in now if state.id == EGO_ID)
        others = [state for state in now if state.id != EGO_ID]
        levels = incentive_levels(world.road, others, [state.lane for state in others], ego, world.horizon)
        for state, level in zip(others, levels, strict=True):
            changing = world.road.lane_at(state.y) != state.lane
            if changing or abs(state.x - ego.x) > NEAR or state.id not in later.index:
                continue
            for side in (0, 1):
                lane = state.lane + 2 * side - 1
                if world.road.has_lane(lane):
                    yield _kind(world, state.lane, lane, int(level[side])), bool(later[state.id] == lane)


def _kind(world: World, lane: int, target: int, level: int) -> str:
    if target in world.ending and lane not in world.ending:
        return "into a lane that ends"
    if level and lane in world.ending:
        return "ending"
    return LEVELS[level]


def leftovers(run: pd.DataFrame, world: World) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the errors of x after each step of the horizon [m], and how often each mode is seen one period later."""
    run = run[run["step"] % world.steps == 0]
    ego = run[run["vehicle_id"] == EGO_ID].set_index("step")["x_m"]
    others = run[run["vehicle_id"] != EGO_ID]
    others = others.assign(away=(others["x_m"] - others["step"].map(ego)).abs())
    x, speed, accel, away = (
        others.pivot_table(index="step", columns="vehicle_id", values=name, sort=True).to_numpy()
        for name in ("x_m", "speed_mps", "accel_mps2", "away")
    )
    mode = np.where(accel > READ * world.accel, 1, np.where(accel < -READ * world.accel, -1, 0))
    steps = round(world.horizon / world.period)
    errors: list[list[np.ndarray]] = [[] for _ in range(steps)]
    seen = np.zeros(3)
    for start in range(5, len(x) - steps):
        near = (away[start] < NEAR) & (speed[start] > MOVING)
        place, now = x[start], speed[start]
        for k in range(steps):
            # The mode is a branch of the prediction of its own: what is left over is what the modes do not explain.
            after = np.maximum(now + mode[start + k + 1] * world.accel * world.period, 0.0)
            place, now = place + (now + after) / 2 * world.period, after
            errors[k].append((x[start + k + 1] - place)[near])
        seen += np.bincount(mode[start + 1][near & np.isfinite(x[start + 1])] + 1, minlength=3)
    return [np.concatenate(step) for step in errors], seen


def fitted_noise(variance: np.ndarray, period: float) -> tuple[float, float]:
    """Return the variances of position [m2] and speed [m2/s2] of a period that come nearest to those of x, relatively.

    With white noise the variance after k periods of T is k p + q T^2 (0 + 1 + ... + (k - 1)^2).
    """
    k = np.arange(1, len(variance) + 1)
    shape = np.column_stack([k, period**2 * np.cumsum((k - 1) ** 2)])
    position, speed = nnls(shape / variance[:, None], np.ones(len(k)))[0]
    return float(position), float(speed)


def main() -> None:
    """Print how often lane changes begin by density and incentive, the next modes, and what predictions leave over."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    results = sumo_hmdp.load(parser.parse_args().results)
    world = World.of(next(iter(results.manifests.values())))
    density = dict(zip(results.runs["run_id"], results.runs[DENSITY], strict=True))
    runs = dict(tuple(results.steps.groupby("run_id")))
    rows = [(density[run_id], kind, began) for run_id, run in runs.items() for kind, began in chances(run, world)]
    found = pd.DataFrame(rows, columns=["density", "incentive", "began"])
    for name, group in [*found.groupby("density"), ("all", found)]:
        print(f"density {name}\n{group.groupby('incentive')['began'].agg(['sum', 'count', 'mean']).to_string()}\n")
    parts = [leftovers(run, world) for run in runs.values()]
    counts = sum(seen for _, seen in parts)
    print("next mode (braking, cruising, accelerating):", (counts / counts.sum()).round(4))
    errors = [np.concatenate(step) for step in zip(*(found for found, _ in parts), strict=True)]
    variance = np.array([np.nanmean(step**2) for step in errors])
    print("mean squared error of x by step [m2]:", variance.round(4))
    print("noise of a period (m2, m2/s2):", np.round(fitted_noise(variance, world.period), 4))


if __name__ == "__main__":
    main()
