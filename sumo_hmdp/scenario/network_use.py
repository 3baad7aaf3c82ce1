"""What a scenario makes of its network's rules: what cannot be obeyed is refused, and what binds is told."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from sumo_hmdp.decision.problem_schema import PolicyFile
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.road_rules import RoadRules
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import Problem
from sumo_hmdp.scenario.schema import ScenarioFile
from sumo_hmdp.sim.network import Network, read_network
from sumo_hmdp.sim.network_rules import rules_in_force
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.traffic.spawn import DriverKind, Spawn


def rule_checks(scenario: ScenarioFile, network: Network, planner: str, parameters: Any) -> Iterator[Problem]:  # noqa: ANN401
    """Yield where the road's rules cannot be kept.

    Args:
        scenario: the scenario.
        network: its network.
        planner: the planner's name.
        parameters: of the planner.
    """
    limit = None if scenario.traffic is None else scenario.traffic.speed_limit_mps
    rules = rules_in_force(network, limit)
    lowest = min((zone.speed for zone in rules.speed_zones), default=math.inf)
    accel, period = (getattr(parameters, key, None) for key in ("accel_mps2", "period_s"))
    if accel is not None and period is not None and hasattr(parameters, "horizon_steps"):
        path = f"planners.{planner}"
        if accel * period > lowest:
            message = f"must be such that accel_mps2 * period_s is at most the road's lowest limit, {lowest:g} m/s, got"
            yield Problem(f"{path}.period_s", f"{message} {accel * period:g} m/s; the ego could only stand there")
        if parameters.speed_min_mps > lowest:
            message = f"must be at most the road's lowest limit, {lowest:g} m/s, got {parameters.speed_min_mps:g} m/s"
            yield Problem(f"{path}.speed_min_mps", message)
    if scenario.noise:
        for index, vehicle in enumerate(scenario.vehicles):
            for number, policy in enumerate(vehicle.policy):
                yield from _drawn_changes(policy, rules, scenario.lanes.count, f"vehicles[{index}].policy[{number}]")
        traffic = scenario.matched_traffic
        for number, policy in enumerate([] if traffic is None else traffic.policy):
            yield from _drawn_changes(policy, rules, scenario.lanes.count, f"matched_traffic.policy[{number}]")


def _drawn_changes(policy: PolicyFile, rules: RoadRules, count: int, path: str) -> Iterator[Problem]:
    """Yield lane changes that a vehicle drawn from the model would make where the road forbids them."""
    lateral_probs = policy.policy(count).lateral
    for rule in rules.no_change:
        if lateral_probs[rule.lane - 1][rule.lateral + 1] > 0.0:
            where = f"from lane {rule.lane} to the {Lateral(rule.lateral).label}"
            message = f"must not change {where}, which the network forbids from {rule.x_begin:g} to {rule.x_end:g} m"
            yield Problem(f"{path}.lateral_probs", f"{message}; set that probability to 0")
            return


def run_notes(
    world: WorldSettings, ego: VehicleState, spawns: Sequence[Spawn], parameters: Mapping[str, Any]
) -> Iterator[str]:
    """Yield what a reader of a run should know of its network: limits that bind, and what `Network.notes` says."""
    network = read_network(world.net_file, world.road)
    rules = rules_in_force(network, world.speed_limit)
    wanted = [ego.speed, *(value for key, value in parameters.items() if key in {"speed_max_mps", "desired_speed_mps"})]
    wanted += [max(s.speed, s.desired_speed or 0.0) for s in spawns if s.driver != DriverKind.BACKGROUND]
    fastest = max(wanted)
    for speed in sorted({zone.speed for zone in rules.speed_zones if zone.speed < fastest}):
        zones = [zone for zone in rules.speed_zones if zone.speed == speed]
        lanes = ", ".join(str(lane) for lane in sorted({zone.lane for zone in zones}))
        where = f"lane {lanes}, {min(z.x_begin for z in zones):g} to {max(z.x_end for z in zones):g} m"
        kept = "the ego and the drivers that are no script keep to it"
        whose = "the network's" if world.speed_limit is None else "traffic.speed_limit_mps, the"
        yield f"{where}: {whose} speed limit is {speed:g} m/s; {kept}"
    yield from network.notes
