"""The free windows of the ego: what the branches leave free in each of its lane states, step by step.

All lane states of all steps are cut at once, one array row for those that take up the same lanes. Branches that stay
behind, or ahead, of everything that the ego can reach are left out beforehand: in dense traffic that is most of them.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.decision.blocks import BoolArray, merge, running
from sumo_hmdp.decision.distance import Clearance
from sumo_hmdp.decision.lattice import EgoLattice
from sumo_hmdp.decision.occupancy import LaneStep, occupied_lanes, shares_lane
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, DecisionProblem
from sumo_hmdp.decision.stop_lines import farthest_stop
from sumo_hmdp.prediction.branches import Branches, IntArray
from sumo_hmdp.prediction.dynamics import FloatArray

Level = tuple[int, int]
# A set of branches, one bit each.
Bits = NDArray[np.uint64]

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
class Windows:
    """What n branches leave free at one step: W windows, by lane state, then by speed level, then from behind to ahead.

    Attributes:
        state: (W,) index of the lane state.
        level: (W,) speed level.
        phase: (W,) phase of that speed level.
        behind: (W, n / 64 rounded up) the branches that share a lane with the state and are behind the window.
        ahead: (W, n / 64 rounded up) likewise ahead of it.
        bounds: (4, W) low, high, soft_low and soft_high [units of the lattice].
        stop_high: (W,) upper end of where the ego may come to rest if it brakes from here, else infinite.
    """

    state: IntArray
    level: IntArray
    phase: IntArray
    behind: Bits
    ahead: Bits
    bounds: FloatArray
    stop_high: FloatArray

    def part(self, which: slice) -> "Windows":
        """Return some of them."""
        return Windows(
            state=self.state[which],
            level=self.level[which],
            phase=self.phase[which],
            behind=self.behind[which],
            ahead=self.ahead[which],
            bounds=self.bounds[:, which],
            stop_high=self.stop_high[which],
        )


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

    def start(self, problem: DecisionProblem, branches: Branches, lanes: LaneStep) -> Windows:
        """Describe step 0 like a step with a single window, where the ego is."""
        shares = shares_lane(problem, branches, lanes.states[0])[self.vehicle]
        is_ahead = np.array([v.state.x >= problem.ego.x for v in problem.vehicles], dtype=bool)[self.vehicle]
        zero = np.zeros(1, dtype=np.int64)
        behind, ahead = _bits((shares & ~is_ahead)[None]), _bits((shares & is_ahead)[None])
        return Windows(zero, zero, zero, behind, ahead, np.zeros((4, 1)), np.full(1, np.inf))

    def windows(self, lattice: EgoLattice, places: Sequence[Place]) -> list[Windows]:
        """Merge the forbidden stretches of each place into blocks and list the windows between them, within reach.

        Returns:
            The windows of each step 1..H.
        """
        if not places:
            none, nobody = np.zeros(0, dtype=np.int64), _bits(np.zeros((0, len(self.vehicle)), dtype=bool))
            return [Windows(none, none, none, nobody, nobody, np.zeros((4, 0)), np.zeros(0))] * lattice.steps
        hard, soft = zip(*(self.stretches[lattice.speed_at(*place.level)] for place in places), strict=True)
        ks = np.array([place.k for place in places])
        layout = _layout(tuple(place.lanes for place in places))
        of_rows = self.occupied.T.take(ks[layout.layer], axis=1)
        member = np.logical_or.reduce(layout.occupied.T[:, :, None] & of_rows, axis=0)
        merged = merge(
            _of_steps([s.low for s in hard], ks), _of_steps([s.high for s in hard], ks), member, layout.layer
        )
        # Flat: that is much faster than np.nonzero in two dimensions.
        begins = merged.first.take(layout.state_row, axis=0)
        state, gap = np.divmod(np.flatnonzero(begins), begins.shape[1])
        row, at = layout.state_row[state], layout.state_layer[state]
        ends = np.empty((4, len(state)))
        ends[0], ends[1] = merged.reach[row, gap], merged.low[at, gap]
        relaxed = hard[0] is not soft[0]
        if relaxed:
            # Within a window the worst distance to all that is behind, and to all that is ahead, counts.
            far, near = (
                np.take_along_axis(_of_steps(bounds, ks), merged.order, axis=1)[layout.layer]
                for bounds in ([s.high for s in soft], [s.low for s in soft])
            )
            behind = running(np.maximum, np.where(merged.member, far, -np.inf), -np.inf)
            ahead = running(np.minimum, np.where(merged.member, near, np.inf)[:, ::-1], np.inf)[:, ::-1]
            ends[2], ends[3] = behind[row, gap], ahead[row, gap]
        else:
            ends[2:] = ends[:2]
        # Metres beyond a line are counted from the line itself too.
        closed = np.concatenate([place.closed for place in places]) + (0.0 if relaxed else DISTANCE_TOLERANCE)
        ends[3] = np.minimum(ends[3], closed[state])
        if not relaxed:
            ends[1] = ends[3]
        drift = np.array([lattice.drift(place.k + 1) for place in places])
        units = _clipped_units(lattice, drift[at], ends, np.array([place.reach for place in places]).T[:, at])
        stops = (closed - drift[layout.state_layer]) / lattice.unit
        matters = (ks + 1 == lattice.steps)[layout.state_layer] & (stops < farthest_stop(lattice))
        stop_high = np.where(matters, stops, np.inf)

        kept = np.flatnonzero(units[0] <= units[1])
        kept = kept[np.lexsort((layout.state_number[state[kept]], ks[at[kept]]))]
        state, at, gap = state[kept], at[kept], gap[kept]
        shares = member.take(row[kept], axis=0)
        behind = shares & (merged.rank.take(at, axis=0) < gap[:, None])
        level, phase = np.array([place.level for place in places])[at].T
        windows = Windows(
            state=layout.state_number[state],
            level=level,
            phase=phase,
            behind=_bits(behind),
            ahead=_bits(shares & ~behind),
            bounds=units[:, kept],
            stop_high=stop_high[state],
        )
        ends_of = np.searchsorted(ks[at], np.arange(lattice.steps + 1)).tolist()
        return [windows.part(slice(begin, end)) for begin, end in pairwise(ends_of)]


@dataclass(frozen=True, eq=False)
class _Layout:
    """How the lane states of J places lie in common arrays: R footprints of all places and S states.

    Attributes:
        occupied: (R, lanes) which lanes each footprint covers.
        layer: (R,) whose place each is.
        state_layer: (S,) whose place each state is.
        state_row: (S,) the footprint of each.
        state_number: (S,) its index among those of its place.
    """

    occupied: BoolArray
    layer: IntArray
    state_layer: IntArray
    state_row: IntArray
    state_number: IntArray


@lru_cache(maxsize=256)
def _layout(lanes: tuple[LaneStep, ...]) -> _Layout:
    """Lay out the lane states of some places, which are often the same from one decision to the next."""
    rows = [len(step.occupied) for step in lanes]
    sizes = [len(step.footprint) for step in lanes]
    return _Layout(
        occupied=np.concatenate([step.occupied for step in lanes]),
        layer=np.repeat(np.arange(len(lanes)), rows),
        state_layer=np.repeat(np.arange(len(lanes)), sizes),
        state_row=np.concatenate(
            [top + step.footprint for top, step in zip(accumulate(rows, initial=0), lanes, strict=False)]
        ),
        state_number=np.concatenate([np.arange(size) for size in sizes]),
    )


def _bits(members: BoolArray) -> Bits:
    """Return W sets of branches, (W, n), as bits."""
    count, n = members.shape
    padded = np.zeros((count, -(-n // 64) * 64), dtype=bool)
    padded[:, :n] = members
    return np.packbits(padded, axis=1).view(np.uint64)


def _of_steps(bounds: Sequence[FloatArray], ks: IntArray) -> FloatArray:
    """Return column k of each of J bounds (n, H), shape (J, n)."""
    return np.array([bound[:, k] for bound, k in zip(bounds, ks.tolist(), strict=True)])


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
    points = [farthest_points(lattice, k) for k in steps]
    back = np.array([lattice.position_at(k, low - 1) for k, (low, _) in zip(steps, points, strict=True)])
    front = np.array([lattice.position_at(k, high + 1) for k, (_, high) in zip(steps, points, strict=True)])
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
