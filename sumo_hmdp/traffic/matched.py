"""Vehicles drawn from the model itself: maneuvers from their policy, motion from the dynamics plus Gaussian noise.

In a world of such vehicles the predictor is right, so what it says of probabilities can be held against counts.
They react to nobody: the whole path of one is drawn before the run, from streams of its own.
"""

from dataclasses import dataclass, replace

import numpy as np

from sumo_hmdp.domain.maneuver import ACTIONS, ManeuverState, Mode, transition
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import InputError
from sumo_hmdp.prediction.dynamics import Noise, next_longitudinal
from sumo_hmdp.prediction.policy import ScheduledPolicy, action_probabilities
from sumo_hmdp.traffic.streams import stream
from sumo_hmdp.vehicle.point_mass import PointMass, advance, change_lane, in_lane

_SAME_INSTANT = 1e-9


@dataclass(frozen=True)
class MatchedModel:
    """What a vehicle is drawn from; the same as its prediction.

    Attributes:
        policy: how it chooses its actions, by time.
        noise: of which the process part moves it; the rest is for who measures it.
        period: between two actions [s].
        accel: of the modes, positive [m/s2].
        lane_change_time: within which it reaches the centre of the lane that it intends [s].
    """

    policy: ScheduledPolicy
    noise: Noise
    period: float
    accel: float
    lane_change_time: float


@dataclass(frozen=True)
class _Period:
    """One period of a path: its beginning, what it does, and the noise that has come in by its end."""

    state: ManeuverState
    successor: ManeuverState
    x: float
    speed: float
    noise_x: float
    noise_speed: float
    lateral: PointMass


@dataclass(frozen=True)
class MatchedPath:
    """Where one vehicle is, at any time of the run.

    Attributes:
        start: as it enters, at time 0.
        model: what it was drawn from.
        periods: one after another.
    """

    start: VehicleState
    model: MatchedModel
    periods: tuple[_Period, ...]

    def at(self, time: float) -> VehicleState:
        """Return the vehicle at a time [s]; at the beginning of a period it still intends its old lane.

        Within a period it moves by the model with the mode before the action, and the noise of the period comes in in
        proportion to time.

        Raises:
            InputError: the time is beyond what was drawn.
        """
        index = int(time / self.model.period + _SAME_INSTANT)
        if not 0 <= index < len(self.periods):
            raise InputError([f"time must be within the drawn {len(self.periods)} periods, got {time} s."])
        period, model = self.periods[index], self.model
        elapsed = max(0.0, time - index * model.period)
        accel = model.accel * period.state.mode
        x, speed = next_longitudinal(np.array(period.x), np.array(period.speed), np.array(accel), elapsed)
        share = elapsed / model.period
        lateral = replace(period.lateral, clock=period.lateral.clock + elapsed)
        begun = elapsed > _SAME_INSTANT
        speed_now = max(0.0, float(speed) + share * period.noise_speed)
        lateral = replace(lateral, speed=speed_now)
        return replace(
            self.start,
            x=float(x) + share * period.noise_x,
            y=lateral.y,
            speed=speed_now,
            accel=accel if speed_now > 0.0 else 0.0,
            heading=lateral.heading,
            lateral_speed=lateral.lateral_speed,
            lane=period.successor.lane if begun else period.state.lane,
            mode=period.state.mode,
        )


def draw_path(start: VehicleState, model: MatchedModel, road: Road, duration: float, seed: int) -> MatchedPath:
    """Draw a vehicle's path from time 0 to a time beyond `duration`.

    The actions come from one stream of the vehicle, the noise from another, so that a change of the policy leaves the
    noise as it was. The position has no lateral noise: the model's constraints speak of lanes.

    Args:
        start: with the lane that it intends and its mode.
        model: what to draw from.
        road: the lanes.
        duration: of the run [s].
        seed: of the run.

    Raises:
        InputError: the policy leaves a state that it reaches without an action.
    """
    actions, noise = stream(seed, "matched-actions", start.id), stream(seed, "matched-noise", start.id)
    deviations = np.sqrt([model.noise.process_position_var, model.noise.process_speed_var])
    state = ManeuverState(start.lane, start.mode)
    x, speed = start.x, start.speed
    lateral = in_lane(start.x, start.y, start.speed, road.lane_at(start.y))
    periods = []
    for index in range(int(duration / model.period) + 2):
        successor = _successor(model.policy, state, index * model.period, road.lane_count, actions.random(), start.id)
        lateral = change_lane(lateral, successor.lane, road.center_y(successor.lane), model.lane_change_time)
        noise_x, noise_speed = (deviations * noise.standard_normal(2)).tolist()
        periods.append(_Period(state, successor, x, speed, noise_x, noise_speed, lateral))
        free_x, free_speed = next_longitudinal(
            np.array(x), np.array(speed), np.array(model.accel * state.mode), model.period
        )
        x, speed = float(free_x) + noise_x, max(0.0, float(free_speed) + noise_speed)
        state, lateral = successor, advance(lateral, 0.0, model.period)
    return MatchedPath(start, model, tuple(periods))


def _successor(
    policy: ScheduledPolicy, state: ManeuverState, time: float, lane_count: int, uniform: float, name: str
) -> ManeuverState:
    """Return the state after an action drawn from pi(a | s) with one uniform number in [0, 1)."""
    row = action_probabilities(policy.at(time))[state.lane - 1, Mode(state.mode) + 1]
    if not row.any():
        raise InputError(
            [f"the policy of {name} must leave it an action in lane {state.lane}, mode {state.mode.label}"]
        )
    cumulative = np.cumsum(row)
    index = int(np.searchsorted(cumulative, uniform * cumulative[-1], side="right"))
    successor = transition(state, ACTIONS[index], lane_count)
    assert successor is not None  # noqa: S101 - an action with probability is admissible
    return successor
