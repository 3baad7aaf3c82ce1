"""Where the ego can be: with a fixed acceleration magnitude its speeds and positions lie on a lattice.

With n_k the sum of the modes up to step k and s_k = sum over j <= k of (2 (k - j) + 1) mode_j,

    v_k = v_0 + accel T n_k,        x_k = x_0 + v_0 k T + (accel T^2 / 2) s_k        (docs/formulation.md, eq. 11)

Both are integers, so solvers meet no rounding error in a position. Where `stopping` is allowed, a step that would
end below zero ends at rest instead, v^2 / (2 accel) farther on; afterwards the ego stands, or starts on the
lattice of whole speed steps. The level n counts such a step as no change from the level just below it, so that it
keeps telling the speed, together with the phase: 0 before such a stop and 1 after it.

An ego outside its speed limits goes back to them as fast as its modes allow: until it is inside, the speeds of that way
are allowed as well (docs/formulation.md, eq. 36).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from sumo_hmdp.decision.problem import SPEED_TOLERANCE, DecisionProblem


class Motion(NamedTuple):
    """The ego after one step of a sequence of modes.

    Attributes:
        level: n.
        phase: 1 after a stop between two lattice speeds, else 0.
        point: position in lattice units ahead of cruising; whole in phase 0.
        speed: [m/s].
    """

    level: int
    phase: int
    point: float
    speed: float


@dataclass(frozen=True)
class EgoLattice:
    """The lattice of one decision.

    Attributes:
        x: position now [m].
        speed: now [m/s].
        period: T [s].
        accel: [m/s2].
        steps: H.
        speed_min: least allowed speed [m/s].
        speed_max: greatest allowed speed [m/s].
        stopping: whether the ego may stop within a step; only ever true where it can come to that.
        mode: of the ego now; it cannot brake in the step after one in which it accelerates, nor the other way round.
    """

    x: float
    speed: float
    period: float
    accel: float
    steps: int
    speed_min: float
    speed_max: float
    stopping: bool = False
    mode: int = 0

    @property
    def speed_step(self) -> float:
        """Difference of two neighbouring speeds [m/s]."""
        return self.accel * self.period

    @property
    def unit(self) -> float:
        """Length of one step of s [m]."""
        return self.accel * self.period**2 / 2

    @cached_property
    def levels_to_rest(self) -> int:
        """How many levels the ego can go down before it would be slower than at rest."""
        return math.floor((self.speed + SPEED_TOLERANCE) / self.speed_step)

    @cached_property
    def rest_share(self) -> float:
        """Speed left on the lowest level of phase 0, as a share of a speed step, in [0, 1)."""
        share = self.speed / self.speed_step - self.levels_to_rest
        return share if share * self.speed_step > SPEED_TOLERANCE else 0.0

    def speed_at(self, level: int, phase: int = 0) -> float:
        """Return the speed at a level and phase [m/s]."""
        if phase:
            return self.speed_step * (self.levels_to_rest + level)
        return self.speed + self.speed_step * level

    def limits(self, step: int) -> tuple[float, float]:
        """Return the least and the greatest allowed speed at the end of a step [m/s] (docs/formulation.md, eq. 36)."""
        braked = self.speed - self.speed_step * (step - (self.mode > 0))
        accelerated = self.speed + self.speed_step * (step - (self.mode < 0))
        return min(self.speed_min, accelerated), max(self.speed_max, braked)

    def allows(self, level: int, phase: int = 0, *, step: int) -> bool:
        """Tell whether the speed at a level is within the limits of the end of a step, 1..H."""
        low, high = self.limits(step)
        return low - SPEED_TOLERANCE <= self.speed_at(level, phase) <= high + SPEED_TOLERANCE

    @property
    def unlimited(self) -> bool:
        """Whether no sequence of modes can get the ego to a limit."""
        change = self.speed_step * self.steps
        return self.speed_min <= self.speed - change and self.speed + change <= self.speed_max

    @cached_property
    def ranges(self) -> tuple[dict[tuple[int, int], tuple[float, float]], ...]:
        """For each step 1..H the (level, phase) that it can end with, and between which points it then ends.

        Speed limits are kept at every step (`allows`); that the mode moves by one level a step is not looked at.
        """
        before, found = [Motion(0, 0, 0.0, self.speed)] * 2, []
        for step in range(1, self.steps + 1):
            reached: dict[tuple[int, int], list[Motion]] = {}
            for motion in before:
                for mode in (-1, 0, 1):
                    after = self.advance(motion, mode)
                    if self.allows(after.level, after.phase, step=step):
                        reached.setdefault((after.level, after.phase), []).append(after)
            # The point after a step grows with the point before it, so the ends of the ranges are enough.
            ends = {key: sorted(motions, key=lambda motion: motion.point) for key, motions in reached.items()}
            found.append({key: (motions[0].point, motions[-1].point) for key, motions in sorted(ends.items())})
            before = [motion for motions in ends.values() for motion in (motions[0], motions[-1])]
        return tuple(found)

    def drift(self, step: int) -> float:
        """Return where the ego is after k steps of cruising [m]."""
        return self.x + self.speed * step * self.period

    def position_at(self, step: int, point: float) -> float:
        """Return x after k steps on a lattice point [m]."""
        return self.drift(step) + self.unit * point

    def advance(self, before: Motion, mode: int) -> Motion:
        """Return the motion one step on (docs/formulation.md, eq. 11)."""
        # A step of the drift is 2 v_0 / (accel T) units, so s grows by twice the speed gained plus the mode.
        gained = before.level - before.phase * self.rest_share
        level = before.level + mode
        if mode < 0 and self.stopping and self.speed_at(level, before.phase) < -SPEED_TOLERANCE:
            stands = before.phase == 1 or not self.rest_share
            stopping_distance = 0.0 if stands else self.rest_share**2
            drift = 2 * self.speed / self.speed_step
            phase = 1 if self.rest_share else 0
            return Motion(-self.levels_to_rest, phase, before.point + stopping_distance - drift, 0.0)
        return Motion(level, before.phase, before.point + 2 * gained + mode, self.speed_at(level, before.phase))

    def walk(self, modes: tuple[int, ...]) -> list[Motion]:
        """Return the motion after each step of a sequence of modes."""
        motion = Motion(0, 0, 0.0, self.speed)
        result = []
        for mode in modes:
            motion = self.advance(motion, mode)
            result.append(motion)
        return result


def ego_lattice(problem: DecisionProblem) -> EgoLattice:
    """Build the lattice of a decision problem."""
    settings = problem.settings
    can_come_to_rest = problem.ego.speed < settings.horizon_steps * settings.accel * settings.period
    return EgoLattice(
        x=problem.ego.x,
        speed=problem.ego.speed,
        period=settings.period,
        accel=settings.accel,
        steps=settings.horizon_steps,
        speed_min=settings.speed_min,
        speed_max=settings.speed_max,
        stopping=settings.stopping and settings.speed_min <= 0 and can_come_to_rest,
        mode=int(problem.ego.mode),
    )
