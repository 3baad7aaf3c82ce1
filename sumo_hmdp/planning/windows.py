"""The free windows of the ego: what the branches leave free in each of its lane states, step by step.

All lane states of all steps are cut at once, one array row for those that take up the same lanes. Branches that stay
behind, or ahead, of everything that the ego can reach are left out beforehand: in dense traffic that is most of them.
"""

from collections.abc import Callable, Iterable, Sequence
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
    """Stretches merged into blocks, in J layers of n stretches, for R sets of lanes.

    Attributes:
        order: (J, n) the stretches of each layer by their lower end.
        low: (J, n + 1) lower ends in that order, then infinity.
        spot: (R, n) where each set's stretches in the order of its layer lie in a flat (R, n) array.
        member: (R, n) which stretches belong to each set, in the order of its layer.
        first: (R, n + 1) whether a stretch in that order begins a block; true at the end, where a last one would.
        reach: (R, n + 1) how far those before it reach; minus infinity before the first block.
    """

    order: IntArray
    low: FloatArray
    spot: IntArray
    member: BoolArray
    first: BoolArray
    reach: FloatArray


def merge(low: FloatArray, high: FloatArray, member: BoolArray, layer: IntArray) -> Merged:
    """Merge stretches.

    Args:
        low: (J, n) lower ends.
        high: (J, n) upper ends.
        member: (R, n) which of them belong to each set of lanes.
        layer: (R,) the layer of each set.
    """
    layers, count = low.shape
    order = np.argsort(low, axis=1, kind="stable")
    # Flat: NumPy's functions along an axis build index arrays that cost more than all else here.
    of_layers = order + count * np.arange(layers)[:, None]
    spot = order[layer] + count * np.arange(len(layer))[:, None]
    high = high.take(of_layers)
    ends = np.full((layers, count + 1), np.inf)
    ends[:, :-1] = low.take(of_layers)
    member = member.take(spot)
    reach = running(np.maximum, np.where(member, high[layer], -np.inf), -np.inf)
    first = np.ones(reach.shape, dtype=bool)
    first[:, :-1] = member & (ends[layer, :-1] >= reach[:, :-1])
    return Merged(order, ends, spot, member, first, reach)


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
        return Stretch(self.low.T.take(rows, axis=1).T, self.high.T.take(rows, axis=1).T)


@dataclass(frozen=True)
class Place:
    """One step at one speed level of the ego.

    Attributes:
        k: index of the step.
        lanes: the ego's lane states at its end.
        closed: (S,) where stop lines close each of them [m].
        level: speed level and phase.
        reach: between which lattice points the ego is there.
    """

    k: int
    lanes: LaneStep
    closed: FloatArray
    level: Level
    reach: tuple[float, float]


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
        stretches: hard and soft stretch that each takes up, by the ego's speed.
    """

    vehicle: IntArray
    occupied: BoolArray
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
            branches.vehicle.take(rows),
            occupied_lanes(problem, branches).T.take(rows, axis=2).T,
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

    def cuts(self, lattice: EgoLattice, places: Sequence[Place]) -> list[Cut]:
        """Merge the forbidden stretches of each place into blocks and list the windows between them, within reach."""
        if not places:
            return []
        hard, soft = zip(*(self.stretches[lattice.speed_at(*place.level)] for place in places), strict=True)
        ks = [place.k for place in places]
        # One row for each footprint of each place, and one state for each lane state of each place.
        rows = np.cumsum([0, *(len(place.lanes.occupied) for place in places)])
        layer = np.repeat(np.arange(len(places)), np.diff(rows))
        state_layer = np.repeat(np.arange(len(places)), [len(place.lanes.footprint) for place in places])
        state_row = np.concatenate([row + p.lanes.footprint for row, p in zip(rows.tolist(), places, strict=False)])
        state_number = np.concatenate([np.arange(len(place.lanes.footprint)) for place in places])
        closed = np.concatenate([place.closed for place in places])
        member: BoolArray = np.concatenate([place.lanes.occupied @ self.occupied[:, place.k].T for place in places])
        merged = merge(_of_steps([s.low for s in hard], ks), _of_steps([s.high for s in hard], ks), member, layer)
        numbers = np.cumsum(merged.first, axis=1) - 1
        block = np.empty(member.shape, dtype=np.int64)
        block.reshape(-1)[merged.spot] = np.where(merged.member, numbers[:, :-1], -1)

        state, gap = np.nonzero(merged.first[state_row])
        row, at = state_row[state], state_layer[state]
        ends = np.empty((4, len(state)))
        ends[0], ends[1] = merged.reach[row, gap], merged.low[at, gap]
        relaxed = hard[0] is not soft[0]
        if relaxed:
            # Within a window the worst distance to all that is behind, and to all that is ahead, counts.
            far, near = (
                np.take_along_axis(_of_steps(bounds, ks), merged.order, axis=1)[layer]
                for bounds in ([s.high for s in soft], [s.low for s in soft])
            )
            behind = running(np.maximum, np.where(merged.member, far, -np.inf), -np.inf)
            ahead = running(np.minimum, np.where(merged.member, near, np.inf)[:, ::-1], np.inf)[:, ::-1]
            ends[2], ends[3] = behind[row, gap], ahead[row, gap]
        else:
            ends[2:] = ends[:2]
        # Metres beyond a line are counted from the line itself too.
        closed = closed if relaxed else closed + DISTANCE_TOLERANCE
        ends[3] = np.minimum(ends[3], closed[state])
        if not relaxed:
            ends[1] = ends[3]
        drift = np.array([lattice.drift(k + 1) for k in ks])
        units = _clipped_units(lattice, drift[at], ends, np.array([place.reach for place in places]).T[:, at])
        stops = (closed - drift[state_layer]) / lattice.unit
        matters = (np.array(ks) + 1 == lattice.steps)[state_layer] & (stops < farthest_stop(lattice))
        stop_high = np.where(matters, stops, np.inf)

        kept = np.flatnonzero(units[0] <= units[1])
        ends_of = np.cumsum([0, *np.bincount(at[kept], minlength=len(places)).tolist()])
        found = []
        for j, place in enumerate(places):
            mine = kept[ends_of[j] : ends_of[j + 1]]
            found.append(
                Cut(
                    level=place.level,
                    order=merged.order[j],
                    block=block[rows[j] : rows[j + 1]],
                    state=state_number[state[mine]],
                    place=gap[mine],
                    number=numbers[row[mine], gap[mine]],
                    bounds=units[:, mine],
                    stop_high=stop_high[state[mine]],
                )
            )
        return found


def _of_steps(bounds: Sequence[FloatArray], ks: Sequence[int]) -> FloatArray:
    """Return column k of each of J bounds (n, H), shape (J, n)."""
    return np.array([bound[:, k] for bound, k in zip(bounds, ks, strict=True)])


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


def _clipped_units(lattice: EgoLattice, drift: FloatArray, ends: FloatArray, reach: FloatArray) -> FloatArray:
    """Return lower and upper ends of windows [m], in turn, as lattice units that the ego can reach.

    Args:
        lattice: of the ego.
        drift: (W,) where it would be, cruising [m].
        ends: (4, W) [m].
        reach: (2, W) between which lattice points it is.
    """
    units = (ends - drift) / lattice.unit
    units[0::2] = np.maximum(units[0::2], reach[0])
    units[1::2] = np.minimum(units[1::2], reach[1])
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
