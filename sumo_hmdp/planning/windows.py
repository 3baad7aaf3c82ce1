"""The free windows of the ego at one step: what the branches leave free in each of its lane states.

All lane states of a step are cut at once, one array row for those that take up the same lanes. Branches that stay
behind, or ahead, of everything that the ego can reach are left out beforehand: in dense traffic that is most of them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.hmdp.branches import Branches, IntArray
from sumo_hmdp.hmdp.dynamics import FloatArray
from sumo_hmdp.planning.distance import Clearance
from sumo_hmdp.planning.lattice import EgoLattice
from sumo_hmdp.planning.occupancy import LaneStep, occupied_lanes, shares_lane
from sumo_hmdp.planning.problem import DISTANCE_TOLERANCE, DecisionProblem
from sumo_hmdp.planning.stop_lines import farthest_stop

BoolArray = NDArray[np.bool_]
Level = tuple[int, int]

# A bound in lattice units that a position meets up to rounding is met.
UNIT_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Clearances:
    """The distances that make windows, by the ego's speed.

    Attributes:
        safe: distances to keep at a speed of the ego [m/s].
        hard: distances that make the windows; the safe ones, or those of contact where a plan may be relaxed.
    """

    safe: Callable[[float], Clearance]
    hard: Callable[[float], Clearance]


@dataclass(frozen=True)
class Merged:
    """Stretches of some rows, merged into blocks for each of U sets of lanes.

    Attributes:
        order: (n,) the rows by the lower end of their stretch.
        low: (n + 1,) lower ends in that order, then infinity.
        first: (U, n + 1) whether a row in that order begins a block; true at the end, where a last one would.
        reach: (U, n + 1) how far those before it reach; minus infinity before the first block.
    """

    order: IntArray
    low: FloatArray
    first: BoolArray
    reach: FloatArray


def merge(low: FloatArray, high: FloatArray, member: BoolArray) -> Merged:
    """Merge stretches from low to high, (n,) each, of the rows that belong to each of U sets of lanes, (U, n)."""
    order = np.argsort(low, kind="stable")
    member = member[:, order]
    ends = np.append(low[order], np.inf)
    reach = running(np.maximum, np.where(member, high[order], -np.inf), -np.inf)
    first = np.ones(reach.shape, dtype=bool)
    first[:, :-1] = member & (ends[:-1] >= reach[:, :-1])
    return Merged(order, ends, first, reach)


def running(extreme: np.ufunc, values: FloatArray, of_none: float) -> FloatArray:
    """Return the extreme of all values before each place and of all of them, (U, n) to (U, n + 1)."""
    result = np.empty((values.shape[0], values.shape[1] + 1))
    result[:, 0] = of_none
    extreme.accumulate(values, axis=1, out=result[:, 1:])
    return result


@dataclass(frozen=True)
class Stretch:
    """Where the ego's front bumper may not be, (n, H) each [m].

    Attributes:
        low: lower end.
        high: upper end.
    """

    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, x: FloatArray, clearance: Clearance, tolerance: float = DISTANCE_TOLERANCE) -> "Stretch":
        """Return the stretches about x; their ends are free, and a distance may miss its bound by the tolerance [m]."""
        return cls(
            x - np.maximum(clearance.behind - tolerance, 0.0),
            x + np.maximum(clearance.ahead - tolerance, 0.0),
        )

    def of_rows(self, rows: IntArray) -> "Stretch":
        """Return those of some rows."""
        return Stretch(self.low[rows], self.high[rows])


@dataclass(frozen=True)
class Cut:
    """One step at one speed level: what the branches leave free in each lane state, W windows.

    Attributes:
        level: speed level and phase.
        order: (n,) rows from behind to ahead; those of a block lie together.
        block: (U, n) the block that each row belongs to, -1 where it takes up none of the footprint's lanes.
        state: (W,) index of the lane state.
        place: (W,) how many rows in `order` are behind the window.
        number: (W,) how many blocks are behind it.
        bounds: (4, W) low, high, soft_low and soft_high.
        stop_high: (W,).
    """

    level: Level
    order: IntArray
    block: IntArray
    state: IntArray
    place: IntArray
    number: IntArray
    bounds: FloatArray
    stop_high: FloatArray


@dataclass(frozen=True)
class Traffic:
    """The n branches that may matter to the ego.

    The others are always behind all that it can reach, or always ahead of it.

    Attributes:
        vehicle: (n,) whose they are.
        occupied: (n, H, lanes) which lanes they take up.
        x: (n, H) [m].
        stretches: hard and soft stretch that each takes up, by the ego's speed.
    """

    vehicle: IntArray
    occupied: BoolArray
    x: FloatArray
    stretches: dict[float, tuple[Stretch, Stretch]]

    @classmethod
    def of(
        cls,
        problem: DecisionProblem,
        lattice: EgoLattice,
        branches: Branches,
        distances: Clearances,
        levels: Iterable[Level],
    ) -> "Traffic":
        """Select the branches for an ego that may have some speed levels."""
        speeds = {lattice.speed_at(*level) for level in levels}
        stretches: dict[float, tuple[Stretch, Stretch]] = {}
        for speed in speeds:
            hard = soft = Stretch.of(branches.x, distances.hard(speed))
            if distances.hard is not distances.safe:
                # What is missing to a soft end is counted from the end itself.
                soft = Stretch.of(branches.x, distances.safe(speed), tolerance=0.0)
            stretches[speed] = hard, soft
        rows = _in_reach(problem, lattice, branches, [soft for _, soft in stretches.values()])
        return cls(
            branches.vehicle[rows],
            occupied_lanes(problem, branches)[rows],
            branches.x[rows],
            {
                speed: (hard.of_rows(rows),) * 2 if hard is soft else (hard.of_rows(rows), soft.of_rows(rows))
                for speed, (hard, soft) in stretches.items()
            },
        )

    def start(self, problem: DecisionProblem, lanes: LaneStep) -> Cut:
        """Describe step 0 like a step with a single window, behind which block 0 lies and ahead of which block 1."""
        shares = shares_lane(problem, lanes.states[0])[self.vehicle]
        is_ahead = np.array([v.state.x >= problem.ego.x for v in problem.vehicles], dtype=np.int64)[self.vehicle]
        order = np.argsort(is_ahead, kind="stable")
        zero, one = np.zeros(1, dtype=np.int64), np.ones(1, dtype=np.int64)
        behind = np.array([len(order) - is_ahead.sum()])
        block = np.where(shares, is_ahead, -1)[None]
        return Cut((0, 0), order, block, zero, behind, one, np.zeros((4, 1)), np.full(1, np.inf))

    def cut(
        self,
        lattice: EgoLattice,
        k: int,
        lanes: LaneStep,
        closed: FloatArray,
        level: Level,
        reach: tuple[float, float],
    ) -> Cut:
        """Merge the forbidden stretches at step index k into blocks and list the windows between them, within reach."""
        hard, soft = self.stretches[lattice.speed_at(*level)]
        member: BoolArray = lanes.occupied @ self.occupied[:, k].T
        merged = merge(hard.low[:, k], hard.high[:, k], member)
        state, place = np.nonzero(merged.first[lanes.footprint])
        footprint = lanes.footprint[state]
        numbers = np.cumsum(merged.first, axis=1) - 1
        block = np.full(member.shape, -1, dtype=np.int64)
        block[:, merged.order] = numbers[:, :-1]
        block[~member] = -1
        ends = np.empty((4, len(state)))
        ends[0], ends[1] = merged.reach[footprint, place], merged.low[place]
        if hard is soft:
            ends[2:] = ends[:2]
        else:
            # Within a window the worst distance to all that is behind, and to all that is ahead, counts.
            there = member[:, merged.order]
            behind = running(np.maximum, np.where(there, soft.high[merged.order, k], -np.inf), -np.inf)
            ahead = running(np.minimum, np.where(there, soft.low[merged.order, k], np.inf)[:, ::-1], np.inf)
            ends[2], ends[3] = behind[footprint, place], ahead[:, ::-1][footprint, place]
        # Metres beyond a line are counted from the line itself too.
        closed = closed + (DISTANCE_TOLERANCE if hard is soft else 0.0)
        ends[3] = np.minimum(ends[3], closed[state])
        if hard is soft:
            ends[1] = ends[3]
        units = _clipped_units(lattice, k + 1, ends, reach)
        kept = np.flatnonzero(units[0] <= units[1])
        stop_high = np.full_like(closed, np.inf)
        if k + 1 == lattice.steps:
            stops = (closed - lattice.drift(k + 1)) / lattice.unit
            stop_high = np.where(stops >= farthest_stop(lattice), np.inf, stops)
        number = numbers[footprint[kept], place[kept]]
        state, place = state[kept], place[kept]
        return Cut(level, merged.order, block, state, place, number, units[:, kept], stop_high[state])


def _in_reach(problem: DecisionProblem, lattice: EgoLattice, branches: Branches, stretches: list[Stretch]) -> IntArray:
    """Return the branches that do not stay behind, or ahead, of everything that the ego can reach.

    Args:
        problem: the decision problem.
        lattice: of its ego.
        branches: of its vehicles.
        stretches: the widest that each branch takes up, at every speed that the ego can have.
    """
    steps = range(1, lattice.steps + 1)
    # One unit more, against rounding.
    back = np.array([lattice.position_at(k, farthest_points(lattice, k)[0] - 1) for k in steps])
    front = np.array([lattice.position_at(k, farthest_points(lattice, k)[1] + 1) for k in steps])
    begins_ahead = np.array([v.state.x >= problem.ego.x for v in problem.vehicles], dtype=bool)[branches.vehicle]
    behind, ahead = ~begins_ahead, begins_ahead
    for stretch in stretches:
        behind = behind & (stretch.high < back).all(axis=1)
        ahead = ahead & (stretch.low > front).all(axis=1)
    return np.flatnonzero(~(behind | ahead))


def _clipped_units(lattice: EgoLattice, step: int, ends: FloatArray, reach: tuple[float, float]) -> FloatArray:
    """Return lower and upper ends of windows [m], in turn, as lattice units that the ego can reach."""
    units = lattice.to_units(step, ends)
    back, front = reach
    units[0::2] = np.maximum(units[0::2], back)
    units[1::2] = np.minimum(units[1::2], front)
    if not lattice.stopping:
        # Positions are whole numbers of units: so are the bounds that matter.
        units[0], units[1] = np.ceil(units[0] - UNIT_TOLERANCE), np.floor(units[1] + UNIT_TOLERANCE)
    return units


def farthest_points(lattice: EgoLattice, step: int) -> tuple[float, float]:
    """Return the least and greatest lattice point within k steps; who stops is at most at rest all the time behind."""
    back = -float(step**2)
    if lattice.stopping:
        back = min(back, (lattice.x - lattice.drift(step)) / lattice.unit)
    return back, float(step**2)
