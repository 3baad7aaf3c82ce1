"""Predictors on recorded traffic: every predictor answers for the same vehicles at the same instants, and is scored.

The whole distribution is scored, not the branches that a decision keeps: the lane that a vehicle intends by the exact
chain of its lateral actions, and the position along the road by the exact mixture over its modes (docs/predictors.md).
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

from sumo_hmdp.decision.encounters import deviations_of
from sumo_hmdp.decision.predictors import Predictor, PredictorContext, build_predictor
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, Scene, VehicleState
from sumo_hmdp.errors import InputError
from sumo_hmdp.prediction.branches import PredictedVehicle
from sumo_hmdp.prediction.dynamics import FloatArray
from sumo_hmdp.prediction.lane_occupancy import lateral_transitions
from sumo_hmdp.prediction.places import places_of
from sumo_hmdp.report.statistics import mean_interval
from sumo_hmdp.scenario.schema import ScenarioFile
from sumo_hmdp.scenario.vehicles import belief_of
from sumo_hmdp.study.store import load
from sumo_hmdp.validation import parse

# A probability of 0 that comes true would cost infinitely much; one in a million is taken instead.
LEAST_PROBABILITY = 1e-6
LEVELS = (0.5, 0.9, 0.95)
SCORES = (
    "lane_log_loss", "lane_brier", "x_log_loss", *(f"coverage_{100 * level:g}_share" for level in LEVELS), "nees",
    "ade_m", "fde_m", "time_per_vehicle_ms",
)  # fmt: skip


def predictor_scores(
    folder: Path,
    names: Sequence[str],
    every: int = 4,
    on_progress: Callable[[float, float], None] | None = None,
) -> pd.DataFrame:
    """Score predictors on the runs of a study.

    Args:
        folder: a results directory with `trace: all`.
        names: of the predictors.
        every: decisions between two scored ones.
        on_progress: told how many runs are done, of how many.

    Returns:
        One row per world (scenario and factors of its traffic), predictor and score: `mean`, `low`, `high` (95 % over
        seeds; None with fewer than two), `seed_count` and `trial_count`. Lane scores are over the whole horizon:
        the lane that is intended at its end. `x_log_loss` and `nees` are of its last step, `ade_m` is over all.

    Raises:
        InputError: if no run keeps the traces of other vehicles, or a predictor is not known.
    """
    results = load(folder)
    traces = {str(run): steps for run, steps in results.steps.groupby("run_id")}
    traced = [run for run, steps in traces.items() if (steps["vehicle_id"] != EGO_ID).any()]
    if not traced:
        raise InputError(["must keep the traces of all vehicles; run the study again with trace: all"], str(folder))
    rows = []
    for number, run in enumerate(sorted(traced)):
        manifest = results.manifests[run]
        seed = int(results.runs.loc[results.runs["run_id"] == run, "seed"].iloc[0])
        if not {"horizon_steps", "accel_mps2", "sensing_range_m"} <= set(manifest["parameters"]):
            continue
        scenes = run_scenes(manifest, traces[run])
        for name in names:
            found = score_run(manifest, scenes, name, every)
            if found is not None:
                rows.append({"world": _world(manifest), "predictor": name, "seed": seed, **found})
        if on_progress is not None:
            on_progress(number + 1, len(traced))
    if not rows:
        message = "must have runs of hmdp_mpc that last longer than its horizon, got none; there is nothing to score"
        raise InputError([message], str(folder))
    return _by_seed(pd.DataFrame(rows))


def _world(manifest: Mapping[str, Any]) -> str:
    factors = manifest.get("factors") or {}
    told = [f"{key}={value}" for key, value in factors.items() if not key.startswith(("planner", "risk", "solver"))]
    return ", ".join([str(manifest["scenario"]), *told])


def _by_seed(frame: pd.DataFrame) -> pd.DataFrame:
    """Return means over seeds; the runs of one seed count as one."""
    rows = []
    for (world, predictor), group in frame.groupby(["world", "predictor"], sort=False):
        per_seed = group.groupby("seed")[list(SCORES)].mean()
        for score in SCORES:
            low, high = mean_interval(per_seed[score].to_numpy())
            rows.append(
                {
                    "world": world,
                    "predictor": predictor,
                    "score": score,
                    "mean": float(per_seed[score].mean()),
                    "low": low,
                    "high": high,
                    "seed_count": len(per_seed),
                    "trial_count": int(group["trial_count"].sum()),
                }
            )
    return pd.DataFrame(rows)


def score_run(manifest: Mapping[str, Any], scenes: Sequence[Scene], name: str, every: int) -> dict[str, float] | None:
    """Return the mean scores of one predictor in one run; None where nothing can be scored.

    Args:
        manifest: of the run, whose planner must be `hmdp_mpc`.
        scenes: as `run_scenes` returns them.
        name: of the predictor.
        every: decisions between two scored ones.
    """
    parameters, context = manifest["parameters"], run_context(manifest)
    predictor = build_predictor(name, context, "--predictor")
    per_period = round(context.period / manifest["dt_s"])
    return _mean_scores(scenes, predictor, context, per_period, (every, float(parameters["sensing_range_m"])))


def run_context(manifest: Mapping[str, Any]) -> PredictorContext:
    """Return what the planner of a recorded run offered to its predictor."""
    scenario, parameters = parse(ScenarioFile, manifest["configuration"]), manifest["parameters"]
    lanes, traffic = scenario.lanes.count, scenario.traffic
    return PredictorContext(
        beliefs={v.id: belief_of(v, lanes, scenario.ego.lane_change_time_s) for v in scenario.vehicles},
        default_belief=None if traffic is None else traffic.belief.belief(lanes, traffic.lane_changes.duration_s),
        accel=parameters["accel_mps2"],
        period=parameters["period_s"],
        horizon_steps=parameters["horizon_steps"],
    )


def run_scenes(manifest: Mapping[str, Any], steps: pd.DataFrame) -> list[Scene]:
    """Return the scenes of a run, step by step, with lateral speeds by differences; all lanes are those intended."""
    road, dt = Road(manifest["lanes"]["count"], manifest["lanes"]["width_m"]), manifest["dt_s"]
    table = steps.sort_values(["step", "vehicle_id"], kind="stable")
    lateral = table.groupby("vehicle_id")["y_m"].diff().fillna(0.0) / dt
    columns = ["vehicle_id", "x_m", "y_m", "speed_mps", "intended_lane", "accel_mps2", "length_m", "width_m"]
    scenes = []
    for _, rows in table.assign(lateral_mps=lateral).groupby("step"):
        states = [
            VehicleState(
                str(i), x, y, v, int(lane), Mode.CRUISE, accel=a, length=length, width=width, lateral_speed=aside
            )
            for i, x, y, v, lane, a, length, width, aside in rows[[*columns, "lateral_mps"]].itertuples(index=False)
        ]
        ego = next(state for state in states if state.id == EGO_ID)
        scenes.append(Scene(float(rows["time_s"].iloc[0]), road, ego, tuple(s for s in states if s.id != EGO_ID)))
    return scenes


def _mean_scores(
    scenes: Sequence[Scene],
    predictor: Predictor,
    context: PredictorContext,
    per_period: int,
    chosen: tuple[int, float],
) -> dict[str, float] | None:
    (every, reach), H = chosen, context.horizon_steps
    memory, found, spent, asked = predictor.initial_memory(), [], 0.0, 0
    states = [{other.id: other for other in scene.others} for scene in scenes]
    for step, scene in enumerate(scenes):
        near = tuple(other for other in scene.others if abs(other.x - scene.ego.x) <= reach)
        seen = Scene(scene.time, scene.road, scene.ego, near)
        memory = predictor.observe(seen, memory)
        if step % per_period:
            continue
        started = time.perf_counter()
        forecast = predictor.predict(seen, memory)
        spent, asked, memory = spent + time.perf_counter() - started, asked + len(near), forecast.memory
        if (step // per_period) % every or step + H * per_period >= len(scenes):
            continue
        for name, vehicle in forecast.vehicles.items():
            later = [states[step + k * per_period].get(name) for k in range(1, H + 1)]
            truth = [state for state in later if state is not None]
            if len(truth) == H:
                found.append(vehicle_scores(vehicle, truth, context))
    if not found:
        return None
    means = pd.DataFrame(found).mean()
    return {**{str(key): float(means[key]) for key in means.index}, "time_per_vehicle_ms": 1000 * spent / asked,
            "trial_count": len(found)}  # fmt: skip


def vehicle_scores(
    vehicle: PredictedVehicle, truth: Sequence[VehicleState], context: PredictorContext
) -> dict[str, float]:
    """Return the scores of one prediction.

    Args:
        vehicle: as predicted.
        truth: how it was after each step 1..H.
        context: period and acceleration of the modes.
    """
    lanes = lane_distribution(vehicle, len(truth))
    outcome = np.arange(len(lanes)) == truth[-1].lane - 1
    mixture = list(position_mixture(vehicle, context))
    errors, levels = [], dict.fromkeys(LEVELS, 0)
    for (mean, std, weight), state in zip(mixture, truth, strict=True):
        below = float(weight @ _cdf(state.x, mean, std))
        errors.append(abs(float(weight @ mean) - state.x))
        for level in LEVELS:
            levels[level] += abs(below - 0.5) <= level / 2
    mean, std, weight = mixture[-1]
    center = float(weight @ mean)
    variance = float(std**2 + weight @ (mean - center) ** 2)
    spread = max(std, 1e-3)
    density = float(weight @ np.exp(-(((truth[-1].x - mean) / spread) ** 2) / 2)) / (spread * np.sqrt(2 * np.pi))
    return {
        "lane_log_loss": -float(np.log(max(float(lanes[outcome].sum()), LEAST_PROBABILITY))),
        "lane_brier": float(((lanes - outcome) ** 2).sum()),
        "x_log_loss": -float(np.log(max(density, LEAST_PROBABILITY))),
        **{f"coverage_{100 * level:g}_share": hits / len(truth) for level, hits in levels.items()},
        "nees": errors[-1] ** 2 / max(variance, 1e-6),
        "ade_m": float(np.mean(errors)),
        "fde_m": errors[-1],
    }


def lane_distribution(vehicle: PredictedVehicle, steps: int) -> FloatArray:
    """Return the probability of intending each lane after some steps, (lanes,) (docs/formulation.md, eq. 45)."""
    lanes = np.zeros(len(vehicle.policy.lateral))
    lanes[vehicle.state.lane - 1] = 1.0
    for k in range(steps):
        left, keep, right = (lanes[:, None] * lateral_transitions(vehicle.policy.at_step(k))).T
        lanes = keep + np.append(left[1:], 0.0) + np.append(0.0, right[:-1])
    return lanes


def position_mixture(
    vehicle: PredictedVehicle, context: PredictorContext
) -> Iterator[tuple[FloatArray, float, FloatArray]]:
    """Yield means (D,) [m], standard deviation [m] and weights (D,) of the front bumper after each step."""
    unit, state = context.accel * context.period**2 / 2, vehicle.state
    speed = state.speed / (context.accel * context.period)
    places = places_of(vehicle.policy.longitudinal, int(state.mode), speed, context.horizon_steps, by_speed=False)
    deviations = deviations_of(vehicle.noise, context.period, context.horizon_steps)
    for k, step in enumerate(places.steps):
        farther = vehicle.drift[k][0] if vehicle.drift else 0.0
        mean = state.x + state.speed * (k + 1) * context.period + unit * step.point + farther
        yield mean, float(deviations[k]), step.place_probability / step.place_probability.sum()


def _cdf(x: float, mean: FloatArray, std: float) -> FloatArray:
    if std == 0.0:
        return np.asarray((x > mean) + 0.5 * (x == mean), dtype=np.float64)
    return np.asarray(ndtr((x - mean) / std), dtype=np.float64)
