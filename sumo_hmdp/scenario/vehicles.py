"""The vehicles of a scenario as the simulation and the planner take them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from sumo_hmdp.decision.predictors import Belief
from sumo_hmdp.domain.maneuver import MODE_BY_LABEL
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.policy import ScheduledPolicy
from sumo_hmdp.scenario.schema import ConstantSpeedFile, IdmFile, ModeScheduleFile, ScenarioFile, VehicleFile
from sumo_hmdp.sim.episode import Driver
from sumo_hmdp.sim.measurement import Measurement, measurement_noise
from sumo_hmdp.sim.world_checks import spawn_state
from sumo_hmdp.traffic.matched import MatchedModel, MatchedPath, draw_path
from sumo_hmdp.traffic.scripted import Clock, ConstantSpeed, GapKeeping, ModeSchedule
from sumo_hmdp.traffic.spawn import DriverKind, IdmParameters, Spawn


def belief_of(vehicle: VehicleFile, lane_count: int, lane_change_time: float) -> Belief:
    """Return what the planner believes of a described vehicle.

    Args:
        vehicle: as described.
        lane_count: of the road.
        lane_change_time: of a vehicle that says nothing else, the ego's [s].
    """
    entries = sorted(((entry.from_s, entry.policy(lane_count)) for entry in vehicle.policy), key=lambda item: item[0])
    return Belief(ScheduledPolicy(tuple(entries)), vehicle.noise(), vehicle.following(lane_change_time))


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


def matched_paths(
    scenario: ScenarioFile, vehicles: Sequence[VehicleFile], road: Road, model_section: Mapping[str, Any], seed: int
) -> dict[str, MatchedPath]:
    """Return the drawn paths of vehicles.

    Args:
        scenario: with `noise`.
        vehicles: all that are drawn from the model.
        road: the lanes.
        model_section: the parameters of `hmdp_mpc`, whose model is the world's.
        seed: of the run.
    """
    paths = {}
    for vehicle in vehicles:
        belief = belief_of(vehicle, road.lane_count, scenario.ego.lane_change_time_s)
        scale = scenario.noise_scale**2
        noise = replace(
            belief.noise,
            process_position_var=belief.noise.process_position_var * scale,
            process_speed_var=belief.noise.process_speed_var * scale,
            process_lateral_var=belief.noise.process_lateral_var * scale,
        )
        model = MatchedModel(
            policy=belief.policy,
            noise=noise,
            period=model_section["period_s"],
            accel=model_section["accel_mps2"],
            following=belief.following,
        )
        start: VehicleState = spawn_state(spawn_of(vehicle), road)
        paths[vehicle.id] = draw_path(start, model, road, scenario.duration_s, seed)
    return paths


def measurement(scenario: ScenarioFile, vehicles: Sequence[VehicleFile], seed: int) -> Measurement:
    """Return how the planner measures: exactly, but for drawn vehicles and for a background that says otherwise."""
    drawn = {}
    if scenario.noise:
        for vehicle in vehicles:
            noise = vehicle.noise()
            drawn[vehicle.id] = measurement_noise(noise.position_var, noise.speed_var, noise.initial_lateral_var)
    measured = Measurement(seed, drawn)
    return measured if scenario.traffic is None else replace(measured, otherwise=scenario.traffic.measurement.noise())
