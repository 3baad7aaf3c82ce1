"""The risk of a plan: an upper bound of the probability that any distance falls short within the horizon.

With L the probability that vehicle i takes up a lane of the ego's footprint f at a step, J that it does so at this step
and the one before, and the encounters of `decision/encounters.py`, the risk of an arc u -> w into step k is

    sum over i of max(0, L_ik(f) N_ik(w) + J_ik(f', f) (passes_ik(u, w) - again_ik(u, w)))

(docs/formulation.md, eq. 40), and the risk of a plan is the sum over its arcs, plus the probability that the
prediction dropped. By Hunter and Worsley's inequality that is at least the probability of the union, for steps that
are independent given the places.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sumo_hmdp.decision.encounters import (
    Distance,
    EgoPlaces,
    StepEncounters,
    dropped_probability,
    encounters,
    in_reach,
    place_count,
)
from sumo_hmdp.decision.graph import DecisionGraph, Grouping, Path
from sumo_hmdp.decision.problem import DecisionProblem, WayOut
from sumo_hmdp.decision.way_out import way_out_risk
from sumo_hmdp.domain.occupancy import Occupancy
from sumo_hmdp.prediction.branches import IntArray, PredictedVehicle
from sumo_hmdp.prediction.dynamics import FloatArray
from sumo_hmdp.prediction.lane_occupancy import LaneRules, LanesTaken, lanes_taken

# What a change of sides costs in the order of relaxed plans, in metres that are missing: more than any distance.
METRES_OF_PASSING = 100.0
# A vehicle that adds less to the risk of a plan is not asked how much of that is contact.
NEGLIGIBLE = 1e-12


@dataclass(frozen=True, eq=False)
class PlaceIndex:
    """The distinct places and hops of the ego at one step, and which of them its motions and arcs are.

    Attributes:
        places: of the ego.
        place: (M,) index of each motion's place.
        hop: (A,) index of each arc's hop.
    """

    places: EgoPlaces
    place: IntArray
    hop: IntArray


@dataclass(frozen=True, eq=False)
class PlanRisk:
    """The risk of every plan of one decision.

    Attributes:
        graph: of the decision.
        vehicles: index of each of the V vehicles that may matter.
        index: places and hops of the ego, step by step.
        taken: probability that each vehicle takes up the lanes of the ego's footprints, step by step.
        safe: encounters by the safe distance, step by step.
        way_out: risk of having no way out, (U, M) by footprint and motion at the end; None where none is asked for.
        dropped: probability that the prediction dropped, of all vehicles.
        problem: the decision problem.
    """

    problem: DecisionProblem
    graph: DecisionGraph
    vehicles: IntArray
    index: tuple[PlaceIndex, ...]
    taken: tuple[LanesTaken, ...]
    safe: tuple[StepEncounters, ...]
    way_out: FloatArray | None
    dropped: float

    @cached_property
    def arcs(self) -> tuple[FloatArray, ...]:
        """Risk of each move and arc, (P, A) for each step; at the last with that of its way out (eqs. 40 and 35)."""
        rows = self._by_arc(self.safe)
        if self.way_out is None:
            return rows
        step = self.graph.steps[-1]
        after = step.moves.footprints[step.moves.pair, 1]
        return (*rows[:-1], rows[-1] + self.way_out[after[:, None], step.motions.after])

    @property
    def place_count(self) -> int:
        """How many places the vehicles that may matter have at the end of the horizon."""
        return place_count(self.problem, self._seen)

    @cached_property
    def contact(self) -> tuple[StepEncounters, ...]:
        """Encounters by the distance below which bodies touch, with the metres missing to the safe one elsewhere."""
        return self._encounters(Distance.CONTACT, missing=False)

    @cached_property
    def shortfall(self) -> tuple[FloatArray, ...]:
        """Expected missing metres of each move and arc, and the price of changing sides, (P, A) for each step."""
        safe = self._encounters(Distance.SAFE, missing=True)
        found = []
        for step, index, taken, near, touch in zip(
            self.graph.steps, self.index, self.taken, safe, self.contact, strict=True
        ):
            if near.missing is None:
                raise ValueError("missing metres were asked for")
            before, after = step.moves.footprints.T
            metres = np.einsum("vq,ve->qe", taken.now[:, after], near.missing)
            passing = np.einsum("vq,vg->qg", taken.both[:, before, after], touch.passes)
            place = index.place[step.motions.after]
            of_pair = metres[:, place] + METRES_OF_PASSING * passing[:, index.hop]
            beyond = step.beyond[step.moves.after[:, None], step.motions.after]
            found.append(np.where(np.isfinite(step.cost), of_pair[step.moves.pair] + beyond, np.inf))
        return tuple(found)

    def of_path(self, path: Path) -> FloatArray:
        """Return what each vehicle adds to the risk of a path at each step, (V, H) (docs/formulation.md, eq. 40)."""
        parts = []
        for step, index, taken, near, move, arc in zip(
            self.graph.steps, self.index, self.taken, self.safe, path.moves, path.arcs, strict=True
        ):
            before, after = step.moves.footprints[step.moves.pair[move]]
            place, hop = index.place[step.motions.after[arc]], index.hop[arc]
            together = taken.both[:, before, after] * (near.passes[:, hop] - near.again[:, hop])
            parts.append(np.maximum(taken.now[:, after] * near.short[:, place] + together, 0.0))
        return np.stack(parts, axis=1)

    def way_out_of(self, path: Path) -> float:
        """Return the risk of having no way out at the end of a path; 0 where none is asked for."""
        if self.way_out is None:
            return 0.0
        step = self.graph.steps[-1]
        after = step.moves.footprints[step.moves.pair[path.moves[-1]], 1]
        return float(self.way_out[after, step.motions.after[path.arcs[-1]]])

    def contact_of_path(self, path: Path) -> float:
        """Return an upper bound of the probability that a path ends in contact, what was dropped included."""
        # A vehicle whose distance never falls short is not touched either.
        near = np.flatnonzero(self.of_path(path).sum(axis=1) > NEGLIGIBLE)
        if not len(near):
            return self.dropped
        places, footprints = [], []
        for step, move, arc in zip(self.graph.steps, path.moves, path.arcs, strict=True):
            motion = step.motions.after[[arc]]
            hops = np.zeros((1, 2), dtype=np.int64)
            places.append(EgoPlaces(step.motions.point[motion], step.x[motion], step.speed[motion], hops))
            footprints.append(step.moves.footprints[step.moves.pair[move]])
        met = encounters(self.problem, [self._seen[row] for row in near], places, Distance.CONTACT)
        total = self.dropped
        for (before, after), taken, here in zip(footprints, self.taken, met, strict=True):
            together = taken.both[near, before, after] * (here.passes[:, 0] - here.again[:, 0])
            total += float(np.maximum(taken.now[near, after] * here.short[:, 0] + together, 0.0).sum())
        return total

    def _encounters(self, distance: Distance, *, missing: bool) -> tuple[StepEncounters, ...]:
        places = [index.places for index in self.index]
        return encounters(self.problem, self._seen, places, distance, missing=missing)

    @property
    def _seen(self) -> list[PredictedVehicle]:
        return [self.problem.vehicles[index] for index in self.vehicles]

    def _by_arc(self, found: Sequence[StepEncounters]) -> tuple[FloatArray, ...]:
        rows = []
        for step, index, taken, near in zip(self.graph.steps, self.index, self.taken, found, strict=True):
            before, after = step.moves.footprints.T
            alone = near.short[:, index.places.hops[:, 1]]
            together = near.passes - near.again
            each = (
                taken.now[:, after, None] * alone[:, None] + taken.both[:, before, after][..., None] * together[:, None]
            )
            of_pair = np.maximum(each, 0.0).sum(axis=0)
            of_arc = of_pair[step.moves.pair[:, None], index.hop]
            rows.append(np.where(np.isfinite(step.cost), of_arc, np.inf))
        return tuple(rows)


def plan_risk(problem: DecisionProblem, graph: DecisionGraph) -> PlanRisk:
    """Return the risk of every plan of a decision (docs/formulation.md, eqs. 38 to 40)."""
    by_speed = problem.settings.distance_hangs_on_speed
    index = _place_index(graph, by_speed=by_speed)
    places = [step.places for step in index]
    reached = in_reach(problem, problem.vehicles, places) if all(len(place.x) for place in places) else ()
    vehicles = [problem.vehicles[row] for row in reached]
    footprints = [graph.start.occupied, *(step.lanes.occupied for step in graph.steps)]
    settings = problem.settings
    rules = LaneRules(problem.road, settings.period, settings.gains, settings.occupancy is Occupancy.SWEPT)
    taken = lanes_taken(vehicles, rules, footprints)
    safe = encounters(problem, vehicles, places, Distance.SAFE)
    dropped = dropped_probability(problem, vehicles).sum() + taken.dropped.sum()
    way_out = None
    if settings.way_out is WayOut.BRAKING and vehicles:
        way_out = way_out_risk(problem, vehicles, graph.steps[-1], taken.steps[-1].now)
    return PlanRisk(
        problem, graph, np.array(reached, dtype=np.int64), index, taken.steps, safe, way_out, float(dropped)
    )


def _place_index(graph: DecisionGraph, *, by_speed: bool) -> tuple[PlaceIndex, ...]:
    """List the distinct places of each step; where distances depend on the ego's speed, each motion is a place."""
    before, found = np.zeros(1, dtype=np.int64), []
    for step in graph.steps:
        motions = step.motions
        places = Grouping(every := np.arange(len(step.x)), every) if by_speed else motions.places
        hops = Grouping(every := np.arange(len(motions.after)), every) if by_speed else motions.hops
        pairs = np.stack([before[motions.before[hops.first]], places.group[motions.after[hops.first]]], axis=1)
        ego = EgoPlaces(motions.point[places.first], step.x[places.first], step.speed[places.first], pairs)
        found.append(PlaceIndex(ego, places.group, hops.group))
        before = places.group
    return tuple(found)
