"""A closed loop of reference, tracker and bicycle, without traffic."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from sumo_hmdp.domain.plan import Command
from sumo_hmdp.domain.road import Road
from sumo_hmdp.vehicle.bicycle import BicycleParameters, BicycleState, advance, from_front_bumper, front_bumper
from sumo_hmdp.vehicle.reference import follow, sample
from sumo_hmdp.vehicle.tracking import TrackingMpc, TrackingWeights


@dataclass(frozen=True)
class Drive:
    """What happened, one row a step, at its end; errors are vehicle minus reference, controls those of the step."""

    time: np.ndarray
    x: np.ndarray
    y: np.ndarray
    x_error: np.ndarray
    y_error: np.ndarray
    heading: np.ndarray
    speed: np.ndarray
    steering_angle: np.ndarray
    accel: np.ndarray
    jerk: np.ndarray
    steering_rate: np.ndarray
    solved: np.ndarray


@pytest.fixture
def drive() -> Callable[..., Drive]:
    def run(
        commands: Callable[[float], Command],
        *,
        speed: float,
        dt: float,
        duration: float,
        lane_change_time: float = 4.0,
        start: BicycleState | None = None,
    ) -> Drive:
        parameters, road = BicycleParameters(), Road(lane_count=2, lane_width=4.0)
        tracker = TrackingMpc(parameters, TrackingWeights(), horizon_steps=15, dt=dt)
        state = start or from_front_bumper(0.0, -2.0, 0.0, speed, parameters)
        reference = None
        rows = []
        for step in range(round(duration / dt)):
            time = step * dt
            if step % round(0.6 / dt) == 0:
                command = commands(round(time, 9))
                reference = follow(
                    command, state, parameters, reference, road=road, time=time, lane_change_time=lane_change_time
                )
            controls, info = tracker.control(state, reference, time)
            state = advance(state, controls, parameters, dt)
            x, y = front_bumper(state, parameters)
            aim = sample(reference, time + dt)
            posture = (state.heading, state.speed, state.steering_angle, state.accel)
            errors = (x - float(aim.x), y - float(aim.y))
            rows.append((time + dt, x, y, *errors, *posture, controls.jerk, controls.steering_rate, info.solved))
        return Drive(*np.array(rows, dtype=float).T)

    return run
