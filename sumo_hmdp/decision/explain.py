"""One answer taken apart: what was predicted, where the lanes are safe, and why no other first action was taken."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sumo_hmdp.decision.decide import Answer
from sumo_hmdp.decision.distance import safe_clearance
from sumo_hmdp.decision.explain_risk import ExplainedRisk, explain_risk, risky_stretches
from sumo_hmdp.decision.first_actions import FirstAction, first_actions
from sumo_hmdp.decision.occupancy import occupied_lanes
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, DecisionProblem
from sumo_hmdp.decision.search import mode_tree
from sumo_hmdp.decision.stop_lines import nearest_line
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.occupancy import LaneState
from sumo_hmdp.prediction.branches import Branches, IntArray


@dataclass(frozen=True)
class ExplainedBranch:
    """One branch of one vehicle; tuples run over the steps 1..H.

    Attributes:
        rank: 1 for the vehicle's likeliest branch.
        probability: of the whole action sequence.
        laterals: lateral actions.
        modes: modes after each step's action.
        lanes: lanes it intends.
        occupied: lanes it takes up, from the left.
        x: mean front bumper [m].
        margin: metres that the chance constraint adds to the safe distance.
    """

    rank: int
    probability: float
    laterals: tuple[Lateral, ...]
    modes: tuple[Mode, ...]
    lanes: tuple[int, ...]
    occupied: tuple[tuple[int, ...], ...]
    x: tuple[float, ...]
    margin: tuple[float, ...]


@dataclass(frozen=True)
class ExplainedVehicle:
    """What was predicted of one vehicle.

    Attributes:
        id: its name.
        branches: all that were retained, likeliest first.
        pruned: probability of all that was dropped.
    """

    id: str
    branches: tuple[ExplainedBranch, ...]
    pruned: float


@dataclass(frozen=True)
class Bound:
    """One end of a window: mean + distance + margin at its lower end, mean - distance - margin at its upper end.

    Attributes:
        x: where it is [m].
        vehicle_id: whose branch it keeps off; `stop line` where it is one, empty where the risk of all vehicles is.
        rank: of that branch; 0 for a stop line and for risk.
        mean: of that branch [m].
        distance: the safe distance without the margin [m].
        margin: of that branch [m].
    """

    x: float
    vehicle_id: str
    rank: int
    mean: float
    distance: float
    margin: float


@dataclass(frozen=True)
class Window:
    """A stretch of a lane that keeps every distance in it; an end is None where nothing bounds it.

    Attributes:
        low: lower end.
        high: upper end.
    """

    low: Bound | None
    high: Bound | None

    @property
    def low_x(self) -> float:
        """Lower end [m], perhaps minus infinity."""
        return -np.inf if self.low is None else self.low.x

    @property
    def high_x(self) -> float:
        """Upper end [m], perhaps infinity."""
        return np.inf if self.high is None else self.high.x


@dataclass(frozen=True)
class ExplainedLane:
    """One lane at the end of one step, taken alone.

    Attributes:
        lane: its number.
        reachable: whether the ego can intend it by then, traffic aside.
        windows: from behind; one more than there are forbidden stretches. Beyond a stop line the last is at infinity.
            Under `joint` they are where being at that step alone risks at most epsilon.
    """

    lane: int
    reachable: bool
    windows: tuple[Window, ...]


@dataclass(frozen=True)
class ExplainedStep:
    """All lanes at the end of one step.

    Attributes:
        step: 1..H.
        time: from now [s].
        ego_speed: that the distances are for [m/s]: the plan's, or the present one where there is no plan.
        reach: least and greatest x that the ego can have by then, traffic aside [m]; None where no mode is admissible.
        lanes: from the left.
    """

    step: int
    time: float
    ego_speed: float
    reach: tuple[float, float] | None
    lanes: tuple[ExplainedLane, ...]


@dataclass(frozen=True)
class Explanation:
    """Why an answer is as it is.

    Attributes:
        problem: the decision problem.
        answer: the answer.
        vehicles: the prediction, in the order of the problem.
        steps: the windows.
        actions: the nine first actions.
        risk: of the plan; None under a rule that does not compute it.
    """

    problem: DecisionProblem
    answer: Answer
    vehicles: tuple[ExplainedVehicle, ...]
    steps: tuple[ExplainedStep, ...]
    actions: tuple[FirstAction, ...]
    risk: ExplainedRisk | None = None

    @property
    def chosen(self) -> FirstAction:
        """The action that was taken."""
        return next(action for action in self.actions if action.chosen)


def explain(problem: DecisionProblem, answer: Answer) -> Explanation:
    """Explain an answer.

    The first actions are solved anew, by the search, whatever solver answered. Its effort grows with the number of
    mode sequences, about 2.4 to the power of the horizon; under `joint` with the number of motions, its square.

    Args:
        problem: the decision problem.
        answer: of that problem.

    Raises:
        decision.search.SearchTooLargeError: if the horizon is too long for the search.
    """
    actions = first_actions(problem, answer)
    order = likeliest_first(answer.branches)
    return Explanation(
        problem=problem,
        answer=answer,
        vehicles=_vehicles(problem, answer, order),
        steps=_steps(problem, answer, _ranks(answer.branches, order)),
        actions=actions,
        risk=explain_risk(answer),
    )


def likeliest_first(branches: Branches) -> list[IntArray]:
    """Return for each vehicle the rows of its branches, likeliest first; ties stay in their order."""
    rows = [np.flatnonzero(branches.vehicle == index) for index in range(len(branches.vehicles))]
    return [mine[np.argsort(-branches.probability[mine], kind="stable")] for mine in rows]


def _ranks(branches: Branches, order: list[IntArray]) -> IntArray:
    """Return the rank of each branch within its vehicle, (B,)."""
    ranks = np.zeros(len(branches.vehicle), dtype=np.int64)
    for rows in order:
        ranks[rows] = np.arange(1, len(rows) + 1)
    return ranks


def _vehicles(problem: DecisionProblem, answer: Answer, order: list[IntArray]) -> tuple[ExplainedVehicle, ...]:
    branches, occupied = answer.branches, occupied_lanes(problem, answer.branches)

    def branch(rank: int, row: int) -> ExplainedBranch:
        return ExplainedBranch(
            rank=rank,
            probability=float(branches.probability[row]),
            laterals=tuple(map(Lateral, branches.laterals[row].tolist())),
            modes=tuple(map(Mode, branches.modes[row].tolist())),
            lanes=tuple(branches.lanes[row].tolist()),
            occupied=tuple(tuple((np.flatnonzero(lanes) + 1).tolist()) for lanes in occupied[row]),
            x=tuple(branches.x[row].tolist()),
            margin=tuple(answer.margin[row].tolist()),
        )

    return tuple(
        ExplainedVehicle(
            id=vehicle.state.id,
            branches=tuple(branch(rank, int(row)) for rank, row in enumerate(rows, start=1)),
            pruned=float(pruned),
        )
        for vehicle, rows, pruned in zip(branches.vehicles, order, branches.pruned, strict=True)
    )


def _steps(problem: DecisionProblem, answer: Answer, ranks: IntArray) -> tuple[ExplainedStep, ...]:
    speeds = [answer.plan[k].speed if answer.plan else problem.ego.speed for k in range(problem.settings.horizon_steps)]
    windows = _windows_by_risk(answer, speeds) if answer.choice else _windows_by_margin(answer, ranks, speeds)
    steps = []
    for k, (reach, reachable) in enumerate(_reaches(problem, answer)):
        lanes = tuple(ExplainedLane(lane, lane in reachable, found) for lane, found in enumerate(windows[k], start=1))
        steps.append(ExplainedStep(k + 1, (k + 1) * problem.settings.period, speeds[k], reach, lanes))
    return tuple(steps)


def _reaches(problem: DecisionProblem, answer: Answer) -> Iterator[tuple[tuple[float, float] | None, set[int]]]:
    """Yield how far the ego can get by each step, and which lanes it can intend, traffic aside."""
    if answer.choice is not None:
        for step in answer.choice.model.graph.steps:
            ends = (float(step.x.min()), float(step.x.max())) if len(step.x) else None
            yield ends, set(step.lanes.lane.tolist())
        return
    for k, prefixes in enumerate(mode_tree(answer.lattice, problem.ego.mode)[1:]):
        reach = None
        if len(prefixes.point):
            least, greatest = float(prefixes.point.min()), float(prefixes.point.max())
            reach = answer.lattice.position_at(k + 1, least), answer.lattice.position_at(k + 1, greatest)
        yield reach, {state.lane for state in answer.corridors.states[k + 1]}


def _windows_by_margin(answer: Answer, ranks: IntArray, speeds: list[float]) -> list[list[tuple[Window, ...]]]:
    """Return the windows of each step and lane that keep every distance with its margin."""
    problem = answer.situation.problem
    occupied, found = occupied_lanes(problem, answer.branches), []
    for k, speed in enumerate(speeds):
        bounds = _bounds(problem, answer, ranks, k, speed)
        found.append(
            [
                _windows([*(bounds[row] for row in np.flatnonzero(mine)), *_line_bounds(problem, lane)])
                for lane, mine in enumerate(occupied[:, k].T, start=1)
            ]
        )
    return found


def _windows_by_risk(answer: Answer, speeds: list[float]) -> list[list[tuple[Window, ...]]]:
    """Return the windows of each step and lane in which being at that step alone risks at most epsilon."""
    return [
        [
            _windows([*(_ends(*ends) for ends in risky), *_line_bounds(answer.situation.problem, lane)])
            for lane, risky in enumerate(lanes, start=1)
        ]
        for lanes in risky_stretches(answer, speeds)
    ]


def _ends(low: float, high: float) -> tuple[Bound, Bound]:
    """Return the ends of a stretch that no single vehicle makes."""
    return Bound(low, "", 0, low, 0.0, 0.0), Bound(high, "", 0, high, 0.0, 0.0)


def _bounds(
    problem: DecisionProblem, answer: Answer, ranks: IntArray, k: int, speed: float
) -> list[tuple[Bound, Bound]]:
    """Return where the forbidden stretch of each branch begins and ends at step index k."""
    branches = answer.branches
    safe = safe_clearance(problem, branches, answer.margin, speed)
    bounds = []
    for row, vehicle in enumerate(branches.vehicle):
        name, rank = branches.vehicles[vehicle].state.id, int(ranks[row])
        mean, margin = float(branches.x[row, k]), float(answer.margin[row, k])
        behind, ahead = float(safe.behind[row, k]), float(safe.ahead[row, k])
        bounds.append(
            (
                Bound(mean - behind, name, rank, mean, behind - margin, margin),
                Bound(mean + ahead, name, rank, mean, ahead - margin, margin),
            )
        )
    return bounds


def _line_bounds(problem: DecisionProblem, lane: int) -> list[tuple[Bound, Bound]]:
    """Return what a stop line forbids in a lane: all that is beyond it."""
    line = nearest_line(problem.ego, problem.stop_lines, LaneState(lane))
    if line is None:
        return []
    low, high = (Bound(x, "stop line", 0, x, 0.0, 0.0) for x in (line.x, np.inf))
    return [(low, high)]


def _windows(forbidden: list[tuple[Bound, Bound]]) -> tuple[Window, ...]:
    """Return what forbidden stretches leave free; of branches that reach equally far the likeliest is named."""
    ends: list[Bound | None] = [None]
    last: Bound | None = None
    for low, high in sorted(forbidden, key=lambda pair: (pair[0].x, pair[0].rank)):
        if last is None or low.x >= last.x - 2 * DISTANCE_TOLERANCE:
            ends += [last, low] if last is not None else [low]
            last = high
        elif (high.x, -high.rank) > (last.x, -last.rank):
            last = high
    ends += [None] if last is None else [last, None]
    return tuple(Window(low, high) for low, high in list(pairwise(ends))[::2])
