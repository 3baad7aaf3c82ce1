"""Traffic drawn from the model: many vehicles that are believed alike, laid out by a density."""

import math
import re
from collections.abc import Iterator

from sumo_hmdp.decision.problem_checks import dead_end_problem, table_checks
from sumo_hmdp.domain.maneuver import ManeuverState, Mode
from sumo_hmdp.errors import Problem
from sumo_hmdp.prediction.policy import dead_end
from sumo_hmdp.scenario.schema import ConstantSpeedFile, MatchedTrafficFile, ScenarioFile, VehicleFile
from sumo_hmdp.sim.network import Network
from sumo_hmdp.traffic.streams import stream

_KM = 1000.0
# A vehicle starts this share of the spacing before or behind its place at most, so that no two are nearer to each other
# than 0.7 spacings; the background traffic varies its gaps as much.
_JITTER = 0.15
# Names are m, the lane, a point and the number of the place, such as m2.-3.
_NAME = re.compile(r"m[0-9]+\.-?[0-9]+")


def matched_vehicles(scenario: ScenarioFile, seed: int) -> list[VehicleFile]:
    """Return the described vehicles and those of `matched_traffic`.

    Places are a spacing apart in each lane. In the ego's lane they are counted from the ego, whose place stays free; in
    every other lane they are shifted by chance. Each lane and vehicle has a stream of its own.

    Args:
        scenario: with or without the section.
        seed: of the run.
    """
    traffic = scenario.matched_traffic
    if traffic is None:
        return scenario.vehicles
    return [*scenario.vehicles, *_laid_out(traffic, scenario, seed)]


def _laid_out(traffic: MatchedTrafficFile, scenario: ScenarioFile, seed: int) -> Iterator[VehicleFile]:
    spacing = _KM / traffic.density_vpkm_per_lane
    low, high = traffic.stretch_m
    shared = traffic.model_dump(exclude={"density_vpkm_per_lane", "stretch_m", "lane_speeds_mps", "policy"})
    for lane, speed in enumerate(traffic.lane_speeds_mps, start=1):
        own = lane == scenario.ego.lane
        first = scenario.ego.x_m + (0.0 if own else spacing * stream(seed, "matched-lane", lane).random())
        for number in range(math.ceil((low - first) / spacing), math.floor((high - first) / spacing) + 1):
            if own and number == 0:
                continue
            name = f"m{lane}.{number}"
            shift = _JITTER * spacing * stream(seed, "matched-place", name).uniform(-1.0, 1.0)
            yield VehicleFile(
                id=name,
                x_m=first + number * spacing + shift,
                lane=lane,
                speed_mps=speed,
                driver=ConstantSpeedFile(kind="constant_speed"),
                policy=traffic.policy,
                **shared,
            )


def is_laid_out(vehicle_id: str) -> bool:
    """Tell the vehicles of `matched_traffic` by their names."""
    return _NAME.fullmatch(vehicle_id) is not None


def matched_traffic_checks(scenario: ScenarioFile, horizon: int) -> Iterator[Problem]:
    """Check the section; its values by themselves are valid.

    Args:
        scenario: the scenario.
        horizon: of the planner, in steps.
    """
    traffic = scenario.matched_traffic
    if traffic is None:
        return
    path, count = "matched_traffic", scenario.lanes.count
    if not scenario.noise:
        yield Problem(path, "must go with `noise: true`, which draws its vehicles from the model; add it")
    if traffic.stretch_m[0] >= traffic.stretch_m[1]:
        yield Problem(f"{path}.stretch_m", f"must be [from, to] with from < to, got {traffic.stretch_m}; swap them")
    if len(traffic.lane_speeds_mps) != count:
        message = f"must have a speed for each of {count} lanes, got {len(traffic.lane_speeds_mps)}"
        yield Problem(f"{path}.lane_speeds_mps", message)
    # Within 0.7 spacings there is to be a vehicle and as much room again.
    most = _KM * (1.0 - 2.0 * _JITTER) / (2.0 * traffic.length_m)
    if traffic.density_vpkm_per_lane > most:
        message = f"must be at most {most:.1f} vehicles/km for vehicles of {traffic.length_m:g} m, got"
        yield Problem(f"{path}.density_vpkm_per_lane", f"{message} {traffic.density_vpkm_per_lane:g}; lower it")
    for index, vehicle in enumerate(scenario.vehicles):
        if is_laid_out(vehicle.id):
            message = f"must not be as those of matched_traffic, m, lane, point, number, got {vehicle.id!r}; rename it"
            yield Problem(f"vehicles[{index}].id", message)
    for index, entry in enumerate(traffic.policy):
        where = f"{path}.policy[{index}]"
        mistakes = list(table_checks(entry.model_dump(), where, count))
        yield from mistakes
        states = [ManeuverState(lane, mode) for lane in range(1, count + 1) for mode in Mode]
        policy = None if mistakes else entry.policy(count)
        stuck = next((found for s in states if policy and (found := dead_end(policy, s, horizon)) is not None), None)
        if stuck is not None:
            yield dead_end_problem(where, stuck)


def stretch_checks(scenario: ScenarioFile, network: Network) -> Iterator[Problem]:
    """Check that the stretch is on the road, with room for who starts before or behind its place.

    Args:
        scenario: the scenario.
        network: its network.
    """
    traffic = scenario.matched_traffic
    if traffic is None:
        return
    spare = _JITTER * _KM / traffic.density_vpkm_per_lane
    low, high = network.x_begin + traffic.length_m + spare, network.x_end - spare
    if not (low <= traffic.stretch_m[0] and traffic.stretch_m[1] <= high):
        message = f"must be within {low:g}..{high:g} m, where whole vehicles are on the road, got {traffic.stretch_m}"
        yield Problem("matched_traffic.stretch_m", message)
