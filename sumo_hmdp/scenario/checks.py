"""Checks of a scenario that take more than one key."""

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeGuard

from sumo_hmdp.decision.problem_checks import dead_end_problem, table_checks
from sumo_hmdp.decision.problem_schema import LANES_MAX, PlannerFile
from sumo_hmdp.documents import is_file
from sumo_hmdp.domain.maneuver import ManeuverState, Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, VehicleState
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.prediction.branches import PredictionTooLargeError, require_few_sequences
from sumo_hmdp.prediction.policy import dead_end
from sumo_hmdp.scenario.packaged import data_folder
from sumo_hmdp.scenario.schema import (
    STEPS_MAX,
    ScenarioFile,
)
from sumo_hmdp.sim.episode import EpisodeSettings
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.sim.trial_load import load_once
from sumo_hmdp.sim.world_checks import WorldSettings, start_problems, world_problems
from sumo_hmdp.traffic.demand import CROWD_PREFIX
from sumo_hmdp.traffic.spawn import Spawn, spawn_problems
from sumo_hmdp.validation import shown


def lane_count(raw: Mapping[str, Any]) -> int | None:
    """Return the number of lanes, None where it is not usable."""
    lanes = raw.get("lanes")
    count = lanes.get("count") if isinstance(lanes, Mapping) else None
    return count if is_whole(count) and 1 <= count <= LANES_MAX else None


def is_whole(value: object) -> TypeGuard[int]:
    """Tell whether a value is a whole number; true and false are none."""
    return isinstance(value, int) and not isinstance(value, bool)


def planner_lane_checks(section: Mapping[str, Any], path: str, count: int | None) -> Iterator[Problem]:
    """Check the lanes that a planner wants or avoids."""
    if count is None:
        return
    nested = section.get("goal")
    goals = {
        "goal_lane": section.get("goal_lane"),
        "goal.lane": nested.get("lane") if isinstance(nested, dict) else None,
    }
    for key, goal in goals.items():
        if is_whole(goal) and not 1 <= goal <= count:
            yield Problem(f"{path}.{key}", f"must be 1..{count}, got {goal}")
    forbidden = section.get("forbidden_lanes")
    if isinstance(forbidden, list):
        for index, lane in enumerate(forbidden):
            if is_whole(lane) and not 1 <= lane <= count:
                yield Problem(f"{path}.forbidden_lanes[{index}]", f"must be 1..{count}, got {lane}")
        if set(range(1, count + 1)) <= {lane for lane in forbidden if is_whole(lane)}:
            yield Problem(f"{path}.forbidden_lanes", "must leave the ego at least one lane; take one out")


def cross_checks(raw: Mapping[str, Any], folder: Path) -> Iterator[Problem]:
    """Check what takes more than one field; values of a wrong type have been reported already."""
    count = lane_count(raw)
    network = raw.get("network")
    if network is None and raw.get("tracks") is None:
        yield Problem("network", "is missing; add it")
    elif raw.get("tracks") is None:
        yield from (
            Problem(f"ego.{key}", "must go with `tracks`; leave it out")
            for key in ("vehicle", "planning_problem")
            if isinstance(raw.get("ego"), Mapping) and raw["ego"].get(key) is not None
        )
    if raw.get("road") is None and isinstance(network, str) and not is_file(network_path(network, folder)):
        known = sorted(path.name.removesuffix(".net.xml") for path in data_folder("networks").glob("*.net.xml"))
        yield Problem(
            "network",
            f"must be a network that exists, got {shown(network)}; known are {', '.join(known)}, or give a path",
        )
    ego = raw.get("ego")
    vehicles = raw.get("vehicles")
    holders = [("ego", ego)] if isinstance(ego, Mapping) else []
    if isinstance(vehicles, list):
        holders += [(f"vehicles[{i}]", v) for i, v in enumerate(vehicles) if isinstance(v, Mapping)]
    seen: set[str] = {EGO_ID}
    for path, holder in holders:
        lane = holder.get("lane")
        if count is not None and is_whole(lane) and not 1 <= lane <= count:
            yield Problem(f"{path}.lane", f"must be 1..{count}, got {lane}")
        vehicle_id = holder.get("id")
        if isinstance(vehicle_id, str):
            if vehicle_id in seen:
                yield Problem(f"{path}.id", f"must be unique and not `{EGO_ID}`, got {vehicle_id!r}; rename it")
            seen.add(vehicle_id)
        policies = holder.get("policy")
        for i, policy in enumerate(policies if isinstance(policies, list) else []):
            yield from table_checks(policy, f"{path}.policy[{i}]", count)


def dead_ends(scenario: ScenarioFile, horizon: int) -> Iterator[Problem]:
    """Find policies that leave a vehicle nothing to do, whatever its mode when they come into force."""
    for index, vehicle in enumerate(scenario.vehicles):
        for i, policy in enumerate(vehicle.policy):
            # Any mode may be the present one when the policy comes into force.
            for mode in Mode:
                stuck = dead_end(policy.policy(scenario.lanes.count), ManeuverState(vehicle.lane, mode), horizon)
                if stuck is not None:
                    yield dead_end_problem(f"vehicles[{index}].policy[{i}]", stuck)
                    break
    if (unseen := scenario.unseen_belief()) is not None:
        path, section = unseen
        belief = section.policy(scenario.lanes.count)
        # Any lane and any mode may be read from a vehicle's motion.
        read = (ManeuverState(lane, mode) for lane in range(1, scenario.lanes.count + 1) for mode in Mode)
        found = next((stuck for state in read if (stuck := dead_end(belief, state, horizon)) is not None), None)
        if found is not None:
            yield dead_end_problem(path, found)


def sequence_checks(scenario: ScenarioFile, planner: str, parameters: Any) -> Iterator[Problem]:  # noqa: ANN401
    """Find policies of which the planner's thresholds leave too many sequences, whatever the state."""
    if not isinstance(parameters, PlannerFile):
        return
    settings = parameters.settings().prediction()
    sections = [entry for vehicle in scenario.vehicles for entry in vehicle.policy]
    sections += [] if scenario.matched_traffic is None else scenario.matched_traffic.policy
    policies = [entry.policy(scenario.lanes.count) for entry in sections]
    unseen = scenario.unseen_belief()
    policies += [] if unseen is None else [unseen[1].policy(scenario.lanes.count)]
    for policy in dict.fromkeys(policies):
        try:
            require_few_sequences(policy, settings)
        except PredictionTooLargeError as error:
            yield Problem(f"planners.{planner}.sequence_threshold", str(error).removeprefix("sequence_threshold "))
            return


def time_checks(scenario: ScenarioFile, planner: str, parameters: Any) -> Iterator[Problem]:  # noqa: ANN401
    """Check that durations and periods are multiples of the step."""
    count = scenario.duration_s / scenario.dt_s
    if count > STEPS_MAX:
        message = f"must be at most {STEPS_MAX} steps of {scenario.dt_s:g} s, got {count:.0f}; shorten it"
        yield Problem("duration_s", message)
    keys = [key for key in ("period_s", "lateral_period_s") if hasattr(parameters, key)]
    periods = ((f"planners.{planner}.{key}", getattr(parameters, key)) for key in keys)
    for path, value in (("duration_s", scenario.duration_s), *periods):
        ratio = value / scenario.dt_s
        if ratio < 0.5 or abs(ratio - round(ratio)) > 1e-6:
            yield Problem(path, f"must be a multiple of dt_s ({scenario.dt_s:g} s), got {value:g} s")


def crowd_checks(scenario: ScenarioFile, *, sumo_drives: bool) -> Iterator[Problem]:
    """Check the background traffic, and what vehicles drawn from the model need.

    Args:
        scenario: the scenario.
        sumo_drives: whether the planner leaves the ego to SUMO.
    """
    traffic = scenario.traffic
    if traffic is not None:
        yield from traffic.problems(scenario.lanes.count, scenario.dt_s, scenario.duration_s)
        belief = traffic.belief
        yield from table_checks(belief.model_dump(), "traffic.belief", scenario.lanes.count)
        for index, vehicle in enumerate(scenario.vehicles):
            if vehicle.id.startswith(CROWD_PREFIX):
                message = (
                    f"must not begin with {CROWD_PREFIX}, as background vehicles do, got {vehicle.id!r}; rename it"
                )
                yield Problem(f"vehicles[{index}].id", message)
        duration, ego_time = traffic.lane_changes.duration_s, scenario.ego.lane_change_time_s
        if sumo_drives and duration != ego_time:
            message = (
                f"must equal ego.lane_change_time_s ({ego_time:g} s) where SUMO drives the ego, got {duration:g} s"
            )
            yield Problem("traffic.lane_changes.duration_s", message)
    if scenario.noise_scale != 1.0 and not scenario.noise:
        message = f"must go with `noise: true`, got {scenario.noise_scale:g} without; add the one or remove the other"
        yield Problem("noise_scale", message)
    if scenario.noise and "hmdp_mpc" not in scenario.planners:
        yield Problem("planners.hmdp_mpc", "is missing; add it, since `noise` draws the vehicles from its model")


def network_checks(net_file: Path, road: Road) -> Iterator[Problem]:
    """Check that the network can be read, that it is the scenario's road, and that SUMO takes it."""
    try:
        read_network(net_file, road)
    except InputError as error:
        where = {"lane_count": "lanes.count", "lane_width": "lanes.width_m", "": "network"}
        yield from _named(error.problems, where)
        return
    refusal = _refusal(net_file, net_file.stat().st_mtime_ns)
    if refusal:
        yield Problem("network", f"must be a network that SUMO loads, got: {refusal} Build it again with netconvert")


# Once for each network and process: what SUMO takes today it takes tomorrow.
@lru_cache(maxsize=16)
def _refusal(net_file: Path, version: int) -> str:
    del version
    return load_once(net_file)


def start_checks(world: WorldSettings, ego: VehicleState, spawns: tuple[Spawn, ...], planner: str) -> Iterator[Problem]:
    """Check that everybody starts on the road and in nobody else; the network has been checked."""
    where = {"ego": "ego.x_m", "ego.lane": "ego.lane", "dt": "dt_s", "": "vehicles"}
    for index, spawn in enumerate(spawns):
        where[f"vehicle {spawn.id}"] = f"vehicles[{index}].x_m"
        where[f"vehicle {spawn.id}.lane"] = f"vehicles[{index}].lane"
        where[f"vehicles[{index}].desired_speed"] = f"vehicles[{index}].driver.desired_speed_mps"
    where["ego.desired_speed"] = f"planners.{planner}.desired_speed_mps"
    problems = [
        *world_problems(world, ego, ()),
        *spawn_problems(spawns, world.road, "vehicles"),
        *start_problems(read_network(world.net_file, world.road), ego, spawns, world.dt),
    ]
    yield from _named(problems, where)


def goal_checks(world: WorldSettings, ego: VehicleState, goal_x: float | None) -> Iterator[Problem]:
    """Check that the ego can drive to where the run shall end."""
    end = read_network(world.net_file, world.road).x_end
    if goal_x is not None and not ego.x < goal_x < end:
        message = f"must be ahead of the ego's start at {ego.x:g} m and before the road's end at {end:g} m"
        yield Problem("ego.goal_x_m", f"{message}, got {goal_x:g} m; move it, or leave it out")


def road_end_notes(world: WorldSettings, episode: EpisodeSettings, parameters: Mapping[str, Any]) -> Iterator[str]:
    """Tell that the ego may reach the road's end before its time is over, which fails a run.

    It is taken to drive as fast as its planner wants to, or as it starts where the planner wants nothing.
    """
    end, ego = read_network(world.net_file, world.road).x_end, episode.ego
    driver = world.ego_driver
    desired = parameters.get("desired_speed_mps") if driver is None else driver.desired_speed
    speed = min(max(ego.speed, desired or 0.0), parameters.get("speed_max_mps") or math.inf)
    if episode.goal_x is None and speed > 0.0 and ego.x + speed * episode.duration >= end:
        when = f"{max(0.0, end - ego.x) / speed:.0f} s of {episode.duration:g} s"
        yield (
            f"the ego may reach the road's end at {end:g} m, at {speed:g} m/s from {ego.x:.0f} m after {when}, and the "
            "run would fail there; set ego.goal_x_m before it, so that the run ends there, or shorten duration_s"
        )


def _named(problems: Iterable[Problem], where: Mapping[str, str]) -> Iterator[Problem]:
    """Return problems with the places in the scenario file that they come from."""
    # A problem of the road stands once a lane, and the message repeats what the path says already.
    for path, message in {problem.path: problem.message for problem in reversed([*problems])}.items():
        text = message[max(0, message.find("must")) :] if path in where and path else message
        yield Problem(where.get(path, path), text)


def network_path(network: str, folder: Path) -> Path:
    """Return a network's file: one of the package by its name, or a path, first from the scenario's folder."""
    packaged = data_folder("networks") / f"{network}.net.xml"
    if is_file(packaged):
        return packaged
    return folder / network if is_file(folder / network) else Path(network)
