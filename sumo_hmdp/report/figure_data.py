"""What a figure of a decision draws, as numbers: lanes over time, relative to where the ego would cruise."""

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise

from sumo_hmdp.decision.explain import ExplainedStep, Explanation
from sumo_hmdp.decision.occupancy import start_state, sweep_steps

# Room around where the ego can be, as a multiple of the longest distance to keep, and at least so much [m].
ROOM, LEAST_ROOM = 1.25, 12.0
# The same under `joint`, where no single distance bounds what is shown [m].
ROOM_BY_RISK = 40.0
# Places that differ by less are one place in a figure [m].
RESOLUTION = 1e-3


@dataclass(frozen=True)
class View:
    """What all panels share.

    Attributes:
        period: of a step [s].
        steps: H.
        low: lower end of the vertical axis [m].
        high: upper end [m].
    """

    period: float
    steps: int
    low: float
    high: float


@dataclass(frozen=True)
class Stretch:
    """A stretch of a lane at the end of a step; ends in metres ahead of the cruising ego."""

    step: int
    low: float
    high: float


@dataclass(frozen=True)
class Spot:
    """All branches of a vehicle that are at one place at the end of a step.

    Attributes:
        step: 0 is now.
        x: mean, ahead of the cruising ego [m].
        probability: of these branches together.
        margin: the largest of theirs [m].
        intended: whether they intend the lane; else the body is over it only.
    """

    step: int
    x: float
    probability: float
    margin: float
    intended: bool


@dataclass(frozen=True)
class Leg:
    """All branches of a vehicle that go from one place to another in a step, and intend the lane at its end.

    Attributes:
        step: at whose end it ends.
        x_from: mean before [m].
        x_to: mean after [m].
        probability: of these branches together.
        enters: whether they intended another lane before.
    """

    step: int
    x_from: float
    x_to: float
    probability: float
    enters: bool


@dataclass(frozen=True)
class Track:
    """One vehicle in one lane."""

    vehicle_id: str
    spots: tuple[Spot, ...]
    legs: tuple[Leg, ...]


@dataclass(frozen=True)
class EgoPoint:
    """The ego at the end of a step of its plan; step 0 is now.

    Attributes:
        step: 0..H.
        x: ahead of the cruising ego [m].
        lane: that it intends.
        over: the lanes that it is leaving.
    """

    step: int
    x: float
    lane: int
    over: tuple[int, ...]


@dataclass(frozen=True)
class LaneView:
    """One lane.

    Attributes:
        forbidden: what the safe distances take.
        safe: what is left of it; ends may be infinite.
        reachable: what of that is within the ego's reach.
        tracks: the vehicles that take it up at some step, in the order of the problem.
    """

    forbidden: tuple[Stretch, ...]
    safe: tuple[Stretch, ...]
    reachable: tuple[Stretch, ...]
    tracks: tuple[Track | None, ...]


def decision_view(explanation: Explanation) -> View:
    """Return axes that hold all that the ego can reach, and whatever can be in its way."""
    settings = explanation.problem.settings
    reach = [0.0]
    room = LEAST_ROOM if explanation.risk is None else ROOM_BY_RISK
    for step in explanation.steps:
        if step.reach is not None:
            reach += [relative(explanation, step.step, end) for end in step.reach]
        windows = (window for lane in step.lanes for window in lane.windows)
        bounds = (bound for window in windows for bound in (window.low, window.high) if bound is not None)
        room = max([room, *(ROOM * (bound.distance + bound.margin) for bound in bounds)])
    return View(settings.period, settings.horizon_steps, min(reach) - room, max(reach) + room)


def relative(explanation: Explanation, step: int, x: float) -> float:
    """Return how far x is ahead of the cruising ego at the end of a step [m]."""
    return x - explanation.answer.lattice.drift(step)


def lane_view(explanation: Explanation, lane: int) -> LaneView:
    """Return what is to be drawn of a lane."""
    forbidden: list[Stretch] = []
    safe: list[Stretch] = []
    reachable: list[Stretch] = []
    for step in explanation.steps:
        forbidden += _forbidden(explanation, step, lane)
        safe += [_stretch(explanation, step.step, w.low_x, w.high_x) for w in step.lanes[lane - 1].windows]
        reachable += _reachable(explanation, step, lane)
    tracks = tuple(_track(explanation, index, lane) for index in range(len(explanation.vehicles)))
    return LaneView(tuple(forbidden), tuple(safe), tuple(reachable), tracks)


def _forbidden(explanation: Explanation, step: ExplainedStep, lane: int) -> list[Stretch]:
    windows = step.lanes[lane - 1].windows
    ends = ((before.high_x, after.low_x) for before, after in pairwise(windows))
    return [_stretch(explanation, step.step, low, high) for low, high in ends]


def _reachable(explanation: Explanation, step: ExplainedStep, lane: int) -> list[Stretch]:
    here = step.lanes[lane - 1]
    if step.reach is None or not here.reachable:
        return []
    least, greatest = step.reach
    ends = ((max(window.low_x, least), min(window.high_x, greatest)) for window in here.windows)
    return [_stretch(explanation, step.step, low, high) for low, high in ends if low <= high]


def _stretch(explanation: Explanation, step: int, low: float, high: float) -> Stretch:
    return Stretch(step, relative(explanation, step, low), relative(explanation, step, high))


def _track(explanation: Explanation, index: int, lane: int) -> Track | None:
    """Join what a vehicle's branches have in common in a lane; None where none takes it up."""
    vehicle, state = explanation.vehicles[index], explanation.problem.vehicles[index].state
    spots: dict[tuple[int, float, bool], list[float]] = defaultdict(lambda: [0.0, 0.0])
    legs: dict[tuple[int, float, float, bool], float] = defaultdict(float)
    if state.lane == lane:
        spots[0, _place(explanation, 0, state.x), True] = [1.0, 0.0]
    for branch in vehicle.branches:
        lanes, x = (state.lane, *branch.lanes), (state.x, *branch.x)
        for k in range(1, len(lanes)):
            if lane not in branch.occupied[k - 1]:
                continue
            here = _place(explanation, k, x[k])
            spot = spots[k, here, lanes[k] == lane]
            spot[0] += branch.probability
            spot[1] = max(spot[1], branch.margin[k - 1])
            if lanes[k] == lane:
                legs[k, _place(explanation, k - 1, x[k - 1]), here, lanes[k - 1] != lane] += branch.probability
    if not spots:
        return None
    return Track(
        vehicle.id,
        tuple(Spot(k, place, p, margin, intended) for (k, place, intended), (p, margin) in sorted(spots.items())),
        tuple(Leg(k, a, b, p, enters) for (k, a, b, enters), p in sorted(legs.items())),
    )


def _place(explanation: Explanation, step: int, x: float) -> float:
    return round(relative(explanation, step, x) / RESOLUTION) * RESOLUTION


def ego_path(explanation: Explanation) -> tuple[EgoPoint, ...]:
    """Return where the ego is now and at the end of each step of its plan."""
    problem = explanation.problem
    state, sweep = start_state(problem), sweep_steps(problem)
    points = [EgoPoint(0, 0.0, state.lane, state.occupied[1:])]
    for step in explanation.answer.plan:
        state = state.after(step.lateral, sweep)
        points.append(EgoPoint(step.step, relative(explanation, step.step, step.x), state.lane, state.occupied[1:]))
    return tuple(points)
