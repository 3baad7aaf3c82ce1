"""Vehicles drawn from the model itself: maneuvers from their policy, motion from the dynamics plus Gaussian noise.

In a world of such vehicles the predictor is right, so what it says of probabilities can be held against counts.
They react to nobody: the whole path of one is drawn before the run, from streams of its own.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from sumo_hmdp.domain.maneuver import ACTIONS, ManeuverState, Mode, transition
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import InputError
from sumo_hmdp.prediction.dynamics import Noise, next_longitudinal
from sumo_hmdp.prediction.lateral import LaneFollowing, next_on_path
from sumo_hmdp.prediction.policy import ScheduledPolicy, action_probabilities
from sumo_hmdp.traffic.streams import stream
from sumo_hmdp.vehicle.reference import MAX_COURSE

_SAME_INSTANT = 1e-9


@dataclass(frozen=True)
class MatchedModel:
    """What a vehicle is drawn from; the same as its prediction.

    Attributes:
        policy: how it chooses its actions, by time.
        noise: of which the process part moves it; the rest is for who measures it.
        period: between two actions [s].
        accel: of the modes, positive [m/s2].
        following: how it moves across the road.
    """

    policy: ScheduledPolicy
    noise: Noise
    period: float
    accel: float
    following: LaneFollowing


@dataclass(frozen=True)
class _Across:
    """Where it is across the road in one period.

    Attributes:
        path: what it follows, at the beginning [m].
        center: of the lane that the path leads to [m].
        deviation: from the path, at the beginning [m].
        noise: that has come in by the end [m].
    """

    path: float
    center: float
    deviation: float
    noise: float

    def at(self, elapsed: float, model: MatchedModel, road: Road) -> tuple[float, float]:
        """Return path and deviation at a time since the beginning [m]."""
        reach = np.array(model.following.change_speed(road) * elapsed)
        path = float(next_on_path(np.array(self.path), np.array(self.center), reach))
        return path, self.deviation * model.following.decay(elapsed) + self.noise * elapsed / model.period

    def speed(self, elapsed: float, model: MatchedModel, road: Road) -> float:
        """Return dy/dt just before a time since the beginning [m/s]."""
        to_go, reach = self.center - self.path, model.following.change_speed(road) * elapsed
        going = math.copysign(model.following.change_speed(road), to_go) if abs(to_go) >= reach > 0.0 else 0.0
        back = -self.deviation * model.following.decay(elapsed) / model.following.keeping_time
        return going + back + self.noise / model.period


@dataclass(frozen=True)
class _Period:
    """One period of a path: its beginning, what it does, and the noise that has come in by its end."""

    state: ManeuverState
    successor: ManeuverState
    x: float
    speed: float
    noise_x: float
    noise_speed: float
    across: _Across


@dataclass(frozen=True)
class MatchedPath:
    """Where one vehicle is, at any time of the run.

    Attributes:
        start: as it enters, at time 0.
        model: what it was drawn from.
        road: the lanes.
        periods: one after another.
    """

    start: VehicleState
    model: MatchedModel
    road: Road
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
        begun = elapsed > _SAME_INSTANT
        speed_now = max(0.0, float(speed) + share * period.noise_speed)
        path, deviation = period.across.at(elapsed, model, self.road)
        lateral_speed = self._lateral_speed(index, elapsed if begun else 0.0)
        course = math.atan2(lateral_speed, speed_now) if lateral_speed else 0.0
        return replace(
            self.start,
            x=float(x) + share * period.noise_x,
            y=path + deviation,
            speed=speed_now,
            accel=accel if speed_now > 0.0 else 0.0,
            heading=min(max(course, -MAX_COURSE), MAX_COURSE),
            lateral_speed=lateral_speed,
            lane=period.successor.lane if begun else period.state.lane,
            mode=period.state.mode,
        )

    def _lateral_speed(self, index: int, elapsed: float) -> float:
        """Return dy/dt up to a time; at the beginning of a period nothing shows yet of what it does in it."""
        if elapsed > 0.0:
            return self.periods[index].across.speed(elapsed, self.model, self.road)
        return self.periods[index - 1].across.speed(self.model.period, self.model, self.road) if index else 0.0


def draw_path(start: VehicleState, model: MatchedModel, road: Road, duration: float, seed: int) -> MatchedPath:
    """Draw a vehicle's path from time 0 to a time beyond `duration`.

    The actions come from one stream of the vehicle, the noise along the road from another and that across it from a
    third, so that a change of the one leaves the others as they were. Across the road it moves as it is predicted to
    (`prediction/lateral.py`), from the centre of its lane.

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
    sideways, lateral_deviation = stream(seed, "matched-lateral", start.id), math.sqrt(model.noise.process_lateral_var)
    deviations = np.sqrt([model.noise.process_position_var, model.noise.process_speed_var])
    state = ManeuverState(start.lane, start.mode)
    x, speed = start.x, start.speed
    path, deviation = start.y, 0.0
    periods = []
    for index in range(int(duration / model.period) + 2):
        successor = _successor(model.policy, state, index * model.period, road.lane_count, actions.random(), start.id)
        noise_x, noise_speed = (deviations * noise.standard_normal(2)).tolist()
        across = _Across(
            path, road.center_y(successor.lane), deviation, lateral_deviation * float(sideways.standard_normal())
        )
        periods.append(_Period(state, successor, x, speed, noise_x, noise_speed, across))
        free_x, free_speed = next_longitudinal(
            np.array(x), np.array(speed), np.array(model.accel * state.mode), model.period
        )
        x, speed = float(free_x) + noise_x, max(0.0, float(free_speed) + noise_speed)
        state, (path, deviation) = successor, across.at(model.period, model, road)
    return MatchedPath(start, model, road, tuple(periods))


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
