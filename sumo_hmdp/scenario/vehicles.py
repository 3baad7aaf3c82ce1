"""The vehicles of a scenario as the simulation and the planner take them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

from sumo_hmdp.domain.maneuver import MODE_BY_LABEL
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.hmdp.policy import ScheduledPolicy
from sumo_hmdp.planning.planner import Belief
from sumo_hmdp.scenario.schema import ConstantSpeedFile, EgoFile, IdmFile, ModeScheduleFile, ScenarioFile, VehicleFile
from sumo_hmdp.scenario.traffic import TrafficFile
from sumo_hmdp.sim.episode import Driver
from sumo_hmdp.sim.libsumo_world import warm_up
from sumo_hmdp.sim.measurement import Measurement, measurement_noise
from sumo_hmdp.sim.world_checks import WorldSettings, spawn_state
from sumo_hmdp.traffic.demand import Demand, arrivals, initial_population, to_spawn
from sumo_hmdp.traffic.matched import MatchedModel, MatchedPath, draw_path
from sumo_hmdp.traffic.scripted import Clock, ConstantSpeed, GapKeeping, ModeSchedule
from sumo_hmdp.traffic.spawn import DriverKind, IdmParameters, Spawn


def belief_of(vehicle: VehicleFile, lane_count: int) -> Belief:
    """Return what the planner believes of a described vehicle."""
    entries = sorted(((entry.from_s, entry.policy(lane_count)) for entry in vehicle.policy), key=lambda item: item[0])
    return Belief(ScheduledPolicy(tuple(entries)), vehicle.noise())


def driver_of(vehicle: VehicleFile) -> Driver | None:
    """Return the driver of a scripted vehicle, None for one that SUMO drives."""
    match vehicle.driver:
        case ConstantSpeedFile():
            return ConstantSpeed()
        case ModeScheduleFile() as file:
            following = file.car_following
            return ModeSchedule(
                switches=tuple((s.from_s, MODE_BY_LABEL[s.mode]) for s in file.switches),
                accel=file.accel_mps2,
                speed_cap=file.speed_max_mps,
                car_following=None
                if following is None
                else GapKeeping(
                    standstill_gap=following.standstill_gap_m,
                    time_gap=following.time_gap_s,
                    gap_gain=following.gap_gain_ps2,
                    speed_gain=following.speed_gain_ps,
                    decel_max=following.decel_max_mps2,
                    accel_max=following.accel_max_mps2,
                    release_surplus=following.release_surplus_m,
                ),
                clock=Clock(file.clock),
            )
        case _:
            return None


def spawn_of(vehicle: VehicleFile) -> Spawn:
    """Return a described vehicle as it enters."""
    common: dict[str, Any] = {
        "id": vehicle.id, "lane": vehicle.lane, "x": vehicle.x_m, "speed": vehicle.speed_mps,
        "length": vehicle.length_m, "width": vehicle.width_m,
    }  # fmt: skip
    if isinstance(vehicle.driver, IdmFile):
        idm = vehicle.driver
        return Spawn(
            **common,
            driver=DriverKind.IDM,
            desired_speed=idm.desired_speed_mps,
            idm=IdmParameters(idm.min_gap_m, idm.time_gap_s, idm.accel_mps2, idm.decel_mps2, idm.exponent),
        )
    return Spawn(**common, driver=DriverKind.SCRIPTED)


def background(traffic: TrafficFile, world: WorldSettings, duration: float) -> tuple[Spawn, ...]:
    """Return the background as it is when the run begins, and who enters later.

    It hangs on the `traffic` section, the network, the step and the seed alone, so that all planners meet the same.

    Args:
        traffic: the section.
        world: with the background's settings; who drives the ego plays no part.
        duration: of the run [s].
    """
    lanes = traffic.lanes or list(range(1, world.road.lane_count + 1))
    return _warm(
        replace(world, ego_driver=None),
        traffic.demand(),
        tuple(lanes),
        (traffic.stretch_m[0], traffic.stretch_m[1]),
        traffic.warm_up_s,
        traffic.warm_up_s + duration if traffic.inflow else 0.0,
    )


# Runs of one seed follow each other in a study, and only differ in who drives the ego.
@lru_cache(maxsize=4)
def _warm(
    world: WorldSettings,
    demand: Demand,
    lanes: tuple[int, ...],
    stretch: tuple[float, float],
    warm_up_time: float,
    inflow_time: float,
) -> tuple[Spawn, ...]:
    present = initial_population(demand, lanes, *stretch, world.seed)
    later = arrivals(demand, lanes, stretch[0], inflow_time, world.seed)
    spawns = [
        replace(to_spawn(vehicle), driver=DriverKind.BACKGROUND, politeness=vehicle.traits.politeness)
        for vehicle in (*present, *later)
    ]
    return warm_up(world, spawns, warm_up_time)


def ego_start(ego: EgoFile, crowd: Sequence[Spawn]) -> tuple[Spawn, tuple[Spawn, ...]]:
    """Return where the ego starts, as a spawn, and the background without the vehicle whose place it takes.

    Args:
        ego: the section.
        crowd: the background.

    Raises:
        InputError: the place hangs on traffic that is not there, or the speed is missing.
    """
    if not ego.in_traffic:
        if ego.speed_mps is None:
            raise InputError([Problem("ego.speed_mps", "is missing; add it, or set ego.in_traffic")])
        return Spawn("ego-start", ego.lane, ego.x_m, ego.speed_mps), tuple(crowd)
    if ego.speed_mps is not None:
        message = f"must be left out with ego.in_traffic, got {ego.speed_mps:g} m/s; the ego takes a vehicle's speed"
        raise InputError([Problem("ego.speed_mps", message)])
    there = [spawn for spawn in crowd if spawn.lane == ego.lane and spawn.time == 0.0]
    if not there:
        message = f"must be in a lane with background traffic, got lane {ego.lane}; change ego.lane or the traffic"
        raise InputError([Problem("ego.in_traffic", message)])
    replaced = min(there, key=lambda spawn: (abs(spawn.x - ego.x_m), spawn.id))
    return replaced, tuple(spawn for spawn in crowd if spawn is not replaced)


def matched_paths(
    scenario: ScenarioFile, road: Road, model_section: Mapping[str, Any], seed: int
) -> dict[str, MatchedPath]:
    """Return the drawn paths of all described vehicles.

    Args:
        scenario: with `noise`.
        road: the lanes.
        model_section: the parameters of `hmdp_mpc`, whose model is the world's.
        seed: of the run.
    """
    paths = {}
    for vehicle in scenario.vehicles:
        belief = belief_of(vehicle, road.lane_count)
        scale = scenario.noise_scale**2
        noise = replace(
            belief.noise,
            process_position_var=belief.noise.process_position_var * scale,
            process_speed_var=belief.noise.process_speed_var * scale,
        )
        model = MatchedModel(
            policy=belief.policy,
            noise=noise,
            period=model_section["period_s"],
            accel=model_section["accel_mps2"],
            lane_change_time=scenario.ego.lane_change_time_s,
        )
        start: VehicleState = spawn_state(spawn_of(vehicle), road)
        paths[vehicle.id] = draw_path(start, model, road, scenario.duration_s, seed)
    return paths


def measurement(scenario: ScenarioFile, lane_count: int, seed: int) -> Measurement:
    """Return how the planner measures: exactly, but for drawn vehicles and for a background that says otherwise."""
    drawn = {}
    if scenario.noise:
        for vehicle in scenario.vehicles:
            noise = belief_of(vehicle, lane_count).noise
            drawn[vehicle.id] = measurement_noise(noise.position_var, noise.speed_var)
    measured = Measurement(seed, drawn)
    return measured if scenario.traffic is None else replace(measured, otherwise=scenario.traffic.measurement.noise())
