"""A tracking MPC: the controls that keep the front bumper on its reference (docs/formulation.md, section 12).

At every step a quadratic program over the next N steps is solved, the vehicle linearised along the reference:

    min   sum over the steps of duration * (weights * (z - z_ref)^2 + weights * u^2)
    s.t.  z[k+1] = A[k] z[k] + B[k] u[k] + c[k]
          jerk, steering_rate, steering_angle and accel within the limits of the vehicle
          speed >= 0, as far as releasing the brakes allows

The first inputs are the controls. The first step of a plan lasts dt, the others PLAN_STEP at least: a plan of less
than a second would not see that the steering is too slow for what it asks, and oscillate. A result depends on the
arguments only, so that any step can be replayed.
"""

from dataclasses import asdict, astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.vehicle.bicycle import BicycleParameters, BicycleState, Controls
from sumo_hmdp.vehicle.linearization import (
    ACCEL,
    SPEED,
    STEERING,
    X,
    Y,
    nominal_states,
    tracked_state,
    transitions,
)
from sumo_hmdp.vehicle.program import TrackingProgram
from sumo_hmdp.vehicle.reference import Reference, sample

FloatArray = NDArray[np.float64]

# Duration of the steps of a plan but the first, if dt is shorter [s].
PLAN_STEP = 0.1

# A braking vehicle may plan to overrun its stop by this speed [m/s]: the physical stop is at zero all the same,
# and without it the last plan before a stop would be a single point, with no interior for the solver to go through.
STOP_TOLERANCE = 0.05


@dataclass(frozen=True)
class TrackingWeights:
    """Costs of the squared deviations from the reference and of the squared inputs, per second; all > 0.

    The closed form loses digits where inputs cost next to nothing: with a billionth of both it is 2e-5 of 320 off.

    Attributes:
        jerk: [s6/m2].
        steering_rate: [s2/rad2].
        x: front bumper along the road [1/m2].
        y: front bumper across the road [1/m2].
        heading: [1/rad2].
        speed: [s2/m2].
        steering_angle: [1/rad2].
        accel: [s4/m2].
    """

    jerk: float = 0.005
    steering_rate: float = 0.5
    x: float = 1.0
    y: float = 20.0
    heading: float = 1.0
    speed: float = 8.0
    steering_angle: float = 1.0
    accel: float = 1.0


@dataclass(frozen=True)
class TrackingInfo:
    """How a control came about.

    Attributes:
        solved: whether the program was solved; if not, the controls are the safe ones.
        status: in the solver's words, or `standing` where nothing was to be solved.
        iterations: of the solver; zero where no bound was met and the optimum has a closed form.
        x_error: of the front bumper now, vehicle minus reference [m].
        y_error: the same across the road [m].
    """

    solved: bool
    status: str
    iterations: int
    x_error: float
    y_error: float


class TrackingMpc:
    """Tracks references with one vehicle; the program is set up once, and keeps no memory of the calls."""

    def __init__(
        self,
        parameters: BicycleParameters,
        weights: TrackingWeights,
        horizon_steps: int,
        dt: float,
        *,
        max_iterations: int = 250,
    ) -> None:
        """Set up the program.

        Args:
            parameters: of the vehicle.
            weights: of the program.
            horizon_steps: N, >= 1.
            dt: of one step, over which the controls are held [s], > 0.
            max_iterations: of the solver, after which it gives up.

        Raises:
            InputError: N, dt or a weight is not positive.
        """
        numbers = {"horizon_steps": horizon_steps, "dt": dt, **asdict(weights)}
        problems = [
            Problem(name, f"must be positive, got {value}. Give a number above zero.")
            for name, value in numbers.items()
            if not value > 0
        ]
        if problems:
            raise InputError(problems, source="tracking")
        self.parameters = parameters
        self.dt = dt
        self.horizon_steps = horizon_steps
        self._durations = np.full(horizon_steps, max(dt, PLAN_STEP))
        self._durations[0] = dt
        self._instants = np.append(0.0, np.cumsum(self._durations))  # (N + 1,), from now
        p, N = parameters, horizon_steps
        lower = np.array([-p.max_jerk, -p.max_steering_rate, 0.0, -p.max_steering_angle, -p.max_decel])
        upper = np.array([p.max_jerk, p.max_steering_rate, np.inf, p.max_steering_angle, p.max_accel])
        self._limits = np.tile(lower, (N, 1)), np.tile(upper, (N, 1))
        self._program = TrackingProgram(np.array(astuple(weights)), self._durations, max_iterations)

    def control(self, state: BicycleState, reference: Reference, time: float) -> tuple[Controls, TrackingInfo]:
        """Return the controls for the next dt.

        A vehicle that stands while the reference stands too is held, without controls. When the solver finds
        no solution, the controls are those of `safe_controls`, and the information says so.

        Args:
            state: of the vehicle now.
            reference: of its front bumper.
            time: now [s].

        Returns:
            The controls, and how they came about.
        """
        samples = sample(reference, time + self._instants)
        now = tracked_state(state, self.parameters)
        targets = nominal_states(state, samples, self.parameters, self._durations)  # (N + 1, 6)
        x_error, y_error = float(now[X] - targets[0, X]), float(now[Y] - targets[0, Y])
        if state.speed == 0 and not samples.speed.any():
            return (
                Controls(0.0, 0.0),
                TrackingInfo(solved=True, status="standing", iterations=0, x_error=x_error, y_error=y_error),
            )
        # x counts from the front bumper, which keeps the numbers of the program small.
        targets[:, X] -= now[X]
        now[X] = 0.0
        points = targets.copy()
        points[:, SPEED] = self._within_reach(state.speed, targets[:, SPEED])
        steps = transitions((points[:-1] + points[1:]) / 2, self.parameters, self._durations)
        solution = self._program.solve(steps, now, targets[1:], self._bounds(state))
        if solution.solved:
            controls = _clipped(solution.inputs[0, 0], solution.inputs[0, 1], self.parameters)
        else:
            controls = safe_controls(
                state, float(targets[1, ACCEL]), float(targets[1, STEERING]), self.parameters, self.dt
            )
        info = TrackingInfo(solution.solved, solution.status, solution.iterations, x_error, y_error)
        return controls, info

    def _within_reach(self, speed: float, targets: FloatArray) -> FloatArray:
        """Return the speeds to linearise at, shape (N + 1,): the targets, as far as accel can bring them about.

        A reference that brakes harder than the vehicle stands before it, and at rest steering has no effect.
        """
        slowest = np.maximum(speed - self.parameters.max_decel * self._instants, 0.0)
        return np.minimum(np.maximum(targets, slowest), speed + self.parameters.max_accel * self._instants)

    def _bounds(self, state: BicycleState) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds of jerk, steering rate, speed, steering angle and accel, each (N, 5).

        The speed may fall below zero only where it does so although the brakes are released at full jerk.
        """
        lower, upper = self._limits
        if state.accel < 0:
            lower = lower.copy()
            released = np.minimum(state.accel + self.parameters.max_jerk * self._instants, 0.0)
            speeds = state.speed + np.cumsum((released[:-1] + released[1:]) / 2 * self._durations)
            lower[:, 2] = np.minimum(speeds - STOP_TOLERANCE, 0.0)
        return lower, upper


def safe_controls(
    state: BicycleState, accel: float, steering_angle: float, parameters: BicycleParameters, dt: float
) -> Controls:
    """Return controls for a step without a solution: steer along the reference, and brake with it or coast.

    Args:
        state: of the vehicle now.
        accel: of the reference after the step [m/s2]; a positive one counts as zero.
        steering_angle: of the reference after the step [rad].
        parameters: of the vehicle.
        dt: [s].

    Returns:
        The controls that come closest to these values within the limits.
    """
    target = min(max(accel, -parameters.max_decel), 0.0)
    angle = min(max(steering_angle, -parameters.max_steering_angle), parameters.max_steering_angle)
    return _clipped((target - state.accel) / dt, (angle - state.steering_angle) / dt, parameters)


def _clipped(jerk: float, steering_rate: float, parameters: BicycleParameters) -> Controls:
    """Return the controls within their limits, which the solver keeps up to its tolerance."""
    max_jerk, max_rate = parameters.max_jerk, parameters.max_steering_rate
    return Controls(
        jerk=min(max(float(jerk), -max_jerk), max_jerk),
        steering_rate=min(max(float(steering_rate), -max_rate), max_rate),
    )
