"""Explanations of small decisions: reasons and windows worked by hand."""

import json
from pathlib import Path

import pytest

from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.explain import explain
from sumo_hmdp.decision.first_actions import Verdict
from sumo_hmdp.decision.problem_file import parse_problem
from sumo_hmdp.decision.search import SearchTooLargeError
from sumo_hmdp.domain.maneuver import Lateral, Mode

FIXTURES = sorted((Path(__file__).parents[2] / "fixtures" / "decisions").glob("*.json"))
LEFT, KEEP, RIGHT = Lateral
DECELERATE, CRUISE, ACCELERATE = Mode
STRAIGHT = {"left": 0.0, "keep": 1.0, "right": 0.0}
CRUISES = {"accelerate": 0.0, "cruise": 1.0, "decelerate": 0.0}


def vehicle(name, lane, x, speed, **entries):
    return {
        "id": name,
        "x_m": x,
        "y_m": 2.0 if lane == 1 else -2.0,
        "speed_mps": speed,
        "lane": lane,
        "mode": "cruise",
        "lateral_probs": STRAIGHT,
        "longitudinal_probs": CRUISES,
        **entries,
    }


def document(*vehicles, mode="cruise", lane=2, **planner):
    """Two lanes; the ego at 0 m with 20 m/s; 1 s steps, so a step of accelerating gains 1 m and 2 m/s."""
    return {
        "lanes": {"count": 2, "width_m": 4.0},
        "planner": {
            "period_s": 1.0,
            "horizon_steps": 2,
            "accel_mps2": 2.0,
            "speed_min_mps": 0.0,
            "speed_max_mps": 40.0,
            "safe_distance_m": 10.0,
            "risk_level": 0.05,
            "risk_allocation": "individual",
            "sequence_threshold": 0.001,
            "maneuver_cost": [[6, 5, 6], [2, 0, 2], [11, 9, 11]],
        }
        | planner,
        "ego": {"x_m": 0.0, "y_m": 2.0 if lane == 1 else -2.0, "speed_mps": 20.0, "lane": lane, "mode": mode},
        "vehicles": list(vehicles),
    }


def explained(content, solver="search"):
    problem = parse_problem(content)
    return explain(problem, answer(problem, solver))


def action(explanation, lateral, mode):
    return next(a for a in explanation.actions if (a.lateral, a.mode) == (lateral, mode))


def test_nine_actions_of_a_free_road_and_what_they_cost():
    found = explained(document())
    assert len({(a.lateral, a.mode) for a in found.actions}) == 9
    assert (found.chosen.lateral, found.chosen.mode, found.chosen.objective) == (KEEP, CRUISE, 0.0)
    # One step of the table, then keep and cruise for nothing.
    costs = {
        (KEEP, ACCELERATE): 5,
        (KEEP, DECELERATE): 9,
        (LEFT, CRUISE): 2,
        (LEFT, ACCELERATE): 6,
        (LEFT, DECELERATE): 11,
    }
    for (lateral, mode), cost in costs.items():
        other = action(found, lateral, mode)
        assert (other.verdict, other.objective, other.violation, other.reason) == (Verdict.FEASIBLE, cost, 0.0, "")
        assert [(s.lateral, s.mode) for s in other.plan] == [(lateral, mode), (KEEP, CRUISE)]


def test_every_rule_that_forbids_an_action_is_told():
    found = explained(document(mode="accelerate", forbidden_lanes=[1], speed_max_mps=21.0))
    assert action(found, KEEP, ACCELERATE).reason == "22.00 m/s is above speed_max, 21 m/s"
    assert action(found, LEFT, CRUISE).reason == "lane 1 is forbidden"
    assert action(found, RIGHT, CRUISE).reason == "there is no lane right of lane 2"
    assert action(found, KEEP, DECELERATE).reason == "the mode cannot go from accelerate to decelerate in one step"
    assert action(found, RIGHT, DECELERATE).reason.count(";") == 1
    assert found.chosen.verdict is Verdict.FEASIBLE
    slow = explained(document(speed_min_mps=19.0))
    assert action(slow, KEEP, DECELERATE).reason == "18.00 m/s is below speed_min, 19 m/s"


def test_an_infeasible_action_names_the_vehicle_the_step_and_the_metres():
    # sv1 stays 10.5 m ahead; accelerating, then cruising, brings the ego 1 m and 3 m nearer than cruising.
    # Decelerating right after accelerating is no choice, so 0.5 m and 2.5 m are missing: 3 m in all.
    found = explained(document(vehicle("sv1", 2, 10.5, 20.0), vehicle("sv2", 1, 0.0, 20.0)))
    fast = action(found, KEEP, ACCELERATE)
    assert (fast.verdict, fast.violation) == (Verdict.SHORT, pytest.approx(3.0))
    assert (fast.worst.vehicle_id, fast.worst.step, fast.worst.metres) == ("sv1", 2, pytest.approx(2.5))
    assert fast.reason == "sv1 at step 2 is 2.50 m too near"
    assert (found.chosen.lateral, found.chosen.mode) == (KEEP, CRUISE)
    # Beside sv2 there is no place at all: bumpers would touch by the end of the first step.
    beside = action(found, LEFT, CRUISE)
    assert (beside.verdict, beside.plan, beside.objective) == (Verdict.CONTACT, (), None)
    assert (beside.contact.step, beside.contact.vehicle_ids) == (1, ("sv2",))
    assert beside.reason == "contact with sv2 at step 1 at the latest"


def test_contact_that_comes_later_names_its_step_and_whom():
    # After two steps the ego is at 36 to 44 m. Bumpers touch within 35.5 to 44.5 m in lane 2 (wall), 33.5 to 42.5 m
    # (side) and 38.5 to 47.5 m (other) in lane 1.
    standing = vehicle("wall", 2, 40.0, 0.0), vehicle("side", 1, 38.0, 0.0), vehicle("other", 1, 43.0, 0.0)
    found = explained(document(*standing))
    assert found.answer.status == "fallback"
    assert (found.chosen.lateral, found.chosen.mode, found.chosen.objective) == (KEEP, DECELERATE, None)
    # 19 m, then 36 or 37 m: `other` is out of reach.
    assert (found.chosen.contact.step, found.chosen.contact.vehicle_ids) == (2, ("wall", "side"))
    # 20 m, then 39 to 41 m.
    beside = action(found, LEFT, CRUISE)
    assert (beside.contact.step, beside.contact.vehicle_ids) == (2, ("wall", "side", "other"))
    assert beside.reason == "contact with wall or side or other at step 2 at the latest"


def test_windows_are_bounded_by_mean_distance_and_margin():
    # A vehicle that keeps (0.8) or comes from lane 1 (0.2); standard deviation 1 m, z(0.05) = 1.6449.
    merging = vehicle(
        "sv1",
        1,
        40.0,
        20.0,
        lateral_probs={"1": {"left": 0.0, "keep": 0.8, "right": 0.2}, "2": STRAIGHT},
        position_var_m2=1.0,
    )
    found = explained(document(merging, vehicle("sv2", 2, -30.0, 20.0)))
    (sv1, sv2) = found.vehicles
    assert [b.rank for b in sv1.branches] == [1, 2, 3]
    assert [b.probability for b in sv1.branches] == pytest.approx([0.64, 0.2, 0.16])
    assert (sv1.pruned, sv2.pruned) == (pytest.approx(0.0), 0.0)
    step = found.steps[0]
    assert (step.time, step.reach) == (1.0, (pytest.approx(19.0), pytest.approx(21.0)))
    behind, between, ahead = step.lanes[1].windows
    assert (behind.low, ahead.high) == (None, None)
    # Lane 2: sv2 at -10 m with no margin; sv1's branch that merges in the first step at 60 m.
    assert (between.low.x, between.low.vehicle_id, between.low.margin) == (pytest.approx(0.0), "sv2", 0.0)
    high = between.high
    assert (high.vehicle_id, high.rank, high.mean, high.distance) == ("sv1", 2, 60.0, pytest.approx(10.0))
    assert (high.margin, high.x) == (pytest.approx(1.6449, abs=1e-4), pytest.approx(48.3551, abs=1e-4))
    # Lane 1: the likeliest of those that stay.
    assert step.lanes[0].windows[0].high.rank == 1
    assert [lane.reachable for lane in step.lanes] == [True, True]


def test_overlapping_stretches_are_one_and_the_outermost_branches_bound_it():
    found = explained(document(vehicle("a", 1, 0.0, 20.0), vehicle("b", 1, 15.0, 20.0)))
    below, above = found.steps[1].lanes[0].windows
    assert (below.high.vehicle_id, below.high.x) == ("a", pytest.approx(30.0))
    assert (above.low.vehicle_id, above.low.x) == ("b", pytest.approx(65.0))


def test_a_horizon_that_the_search_cannot_hold_is_refused():
    # Some 50 million sequences of modes.
    problem = parse_problem(document(horizon_steps=20))
    with pytest.raises(SearchTooLargeError, match=r"horizon_steps 20\)\. Shorten the horizon"):
        explain(problem, answer(problem, "milp"))


@pytest.mark.parametrize("solver", ["milp", "search"])
@pytest.mark.parametrize("path", FIXTURES, ids=lambda path: path.stem)
def test_the_chosen_action_costs_what_the_answer_says(path, solver):
    found = explained(json.loads(path.read_text(encoding="utf-8")), solver)
    assert found.chosen.objective == pytest.approx(found.answer.objective, abs=1e-6)
    assert found.chosen.violation == pytest.approx(found.answer.violation, abs=1e-5)
    assert sum(a.chosen for a in found.actions) == 1
    for other in found.actions:
        if found.answer.status == "optimal" and other.verdict is Verdict.FEASIBLE:
            assert other.objective >= found.answer.objective - 1e-6
