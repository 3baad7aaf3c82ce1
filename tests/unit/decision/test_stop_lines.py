"""Stop lines worked by hand: what they forbid, how they are told, audited, drawn, and what a file may say."""

from dataclasses import replace

import pytest

from sumo_hmdp.decision.audit import audit, shifted
from sumo_hmdp.decision.baselines import ConstantPlanner
from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.explain import explain
from sumo_hmdp.decision.fallback import MAX_BRAKE, braking_demand
from sumo_hmdp.decision.first_actions import Verdict
from sumo_hmdp.decision.highs import compile_model
from sumo_hmdp.decision.optimiser import shape_of, start_values
from sumo_hmdp.decision.planner import HmdpPlanner
from sumo_hmdp.decision.problem import ManeuverSequence
from sumo_hmdp.decision.problem_file import parse_problem, problem_document
from sumo_hmdp.decision.published_rules import PublishedPlanner
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.plan import ForbiddenInterval, Status
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, StopLine, VehicleState
from sumo_hmdp.errors import InputError
from sumo_hmdp.report.explain_text import explanation_text
from sumo_hmdp.report.figures import decision_figure


def document(*lines, lane=2, speed=20.0, x=0.0, **planner):
    """Two lanes; the ego at 20 m/s; two steps of 1 s; modes of 2 m/s2: a step of braking loses 1 m and 2 m/s."""
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
            "stopping": True,
        }
        | planner,
        "ego": {"x_m": x, "y_m": 2.0 if lane == 1 else -2.0, "speed_mps": speed, "lane": lane, "mode": "cruise"},
        "vehicles": [],
        "stop_lines": [_line(*line) for line in lines],
    }


def _line(lanes, place, leaving=None):
    return {"lanes": list(lanes), "x_m": place} | ({} if leaving is None else {"leaving_x_m": leaving})


def problem(*lines, **changes):
    return parse_problem(document(*lines, **changes))


def told(found):
    return [(step.lateral, step.mode) for step in found.plan]


KEEP_CRUISE, KEEP_BRAKE = (Lateral.KEEP, Mode.CRUISE), (Lateral.KEEP, Mode.DECELERATE)


# Both solvers are asked, and must agree.
@pytest.mark.parametrize(
    ("line", "plan", "violation"),
    [
        # Cruising leads to 40 m and to rest 100 m farther on.
        (140.0, [KEEP_CRUISE, KEEP_CRUISE], 0.0),
        # Braking in the first step leads to 37 m with 18 m/s, 81 m before rest; in the second to 39 m, and 120 m.
        (119.9, [KEEP_BRAKE, KEEP_CRUISE], 0.0),
        (118.0, [KEEP_BRAKE, KEEP_CRUISE], 0.0),
        # Braking twice: 36 m, 16 m/s, 64 m.
        (117.9, [KEEP_BRAKE, KEEP_BRAKE], 0.0),
        (100.0, [KEEP_BRAKE, KEEP_BRAKE], 0.0),
        (90.0, [KEEP_BRAKE, KEEP_BRAKE], 10.0),
        # The first step passes it too: 19 - 15 m, and 100 - 15 m.
        (15.0, [KEEP_BRAKE, KEEP_BRAKE], 89.0),
        # Behind the ego it has no effect.
        (-0.01, [KEEP_CRUISE, KEEP_CRUISE], 0.0),
    ],
)
def test_the_ego_can_always_stop(line, plan, violation):
    found = answer(problem(((1, 2), line)), "both")
    assert told(found) == plan
    assert found.violation == pytest.approx(violation)
    assert found.status is (Status.RELAXED if violation else Status.OPTIMAL)


def test_the_lane_beside_is_open():
    # Cruising ends at 40 m: by then the ego must intend lane 1; at the end of the first step, 20 m, it need not.
    found = answer(problem(((2,), 30.0)), "both")
    assert found.status is Status.OPTIMAL
    assert found.plan[-1].lane == 1
    assert found.objective == 2.0
    # A body that is still over the old lane after two steps passes the line: it comes to rest at 100 m at best.
    swept = answer(problem(((2,), 30.0), occupancy="swept"), "both")
    assert (swept.status, swept.violation) == (Status.RELAXED, pytest.approx(70.0))
    assert swept.reason == (
        "no plan keeps every distance and stop line; from step 2 the ego stops 70.00 m beyond the stop line at 30.00 m"
    )


# From rest: accelerating twice leads to 1 m and 4 m, and from 4 m/s to rest 8 m farther after 4 m of cruising.
@pytest.mark.parametrize(
    ("leaving", "lane", "status"),
    [
        # The body is over lane 2 at both steps, and the ego must be able to rest before 16 m.
        (16.0, 1, Status.OPTIMAL),
        (None, 2, Status.OPTIMAL),
    ],
)
def test_an_ego_at_a_merging_room_may_start_into_the_next_lane(leaving, lane, status):
    starts = {"speed_weight": 20.0, "desired_speed_mps": 10.0, "occupancy": "swept"}
    found = answer(problem(((2,), 0.0, leaving), speed=0.0, **starts), "both")
    assert (found.status, found.plan[-1].lane) == (status, lane)
    assert found.plan[-1].x == pytest.approx(0.0 if leaving is None else 4.0)


def test_the_second_place_counts_for_a_body_that_leaves_and_for_who_is_beyond_the_first():
    # A body over lane 2 comes to rest at 100 m at best, braking twice.
    for leaving, status, violation in ((100.0, Status.OPTIMAL, 0.0), (97.0, Status.RELAXED, 3.0)):
        left = answer(problem(((2,), 30.0, leaving), occupancy="swept"), "both")
        assert (left.status, left.violation) == (status, pytest.approx(violation))
        assert left.plan[-1].lane == 1
        assert left.plan[0].lateral is Lateral.LEFT
    beyond = answer(problem(((1, 2), -1.0, 99.0)), "both")
    assert (beyond.status, beyond.violation) == (Status.RELAXED, pytest.approx(1.0))
    assert beyond.reason.endswith("1.00 m beyond the stop line at 99.00 m")


def test_audit_tells_a_second_place_that_came_nearer():
    slow = {"occupancy": "swept", "lane_change_time_s": 8.0}
    asked = problem(((2,), 30.0, 130.0), speed_weight=0.5, desired_speed_mps=20.0, **slow)
    before = answer(asked, "search")
    assert before.status is Status.OPTIMAL
    step = before.plan[0]
    y = asked.road.center_y(2) + 0.1
    ego = replace(asked.ego, x=step.x, y=y, speed=step.speed, lane=step.lane, mode=step.mode)
    nearer = replace(asked, ego=ego, stop_lines=(StopLine(frozenset({2}), 30.0, 50.0),))
    told = audit(nearer, answer(nearer, "search"), (asked, before)).shifted_reason
    assert told.startswith("stop_line:")
    assert told.endswith("beyond the stop line at 50.00 m")


def test_an_ego_that_stands_on_a_line_stays_there():
    wants_on = {"speed_weight": 5.0, "desired_speed_mps": 10.0}
    found = answer(problem(((2,), 8.0 - 5e-7), x=8.0, speed=0.0, maneuver_cost=[[0] * 3] * 3, **wants_on), "both")
    assert found.status is Status.OPTIMAL
    assert [step.lane for step in found.plan if step.x > 8.0 + 1e-6] in ([1], [1, 1])
    closed = answer(problem(((1, 2), 8.0 - 5e-7), x=8.0, speed=0.0, **wants_on), "both")
    assert closed.plan[-1].x == 8.0


def test_lines_out_of_reach_cost_nothing():
    # The farthest stop: 44 m after accelerating twice, 24 m of cruising and 144 m of braking.
    def shape(place):
        asked = problem(((1, 2), place))
        found = answer(asked, "search")
        return shape_of(asked, found.lattice, found.corridors, relaxed=False)

    assert shape(212.1) == replace(shape(211.9), lines=False)
    assert shape(211.9).lines


def test_a_start_beyond_the_line_is_not_used():
    start = ManeuverSequence((Lateral.KEEP,) * 2, (Mode.CRUISE,) * 2)
    for place, usable in ((139.0, False), (140.0, True)):
        # At 40 m/s, so that the lattice knows no stop.
        asked = replace(problem(((1, 2), place + 340.0), speed=40.0, stopping=False), start=start)
        found = answer(asked, "search")
        compiled = compile_model(shape_of(asked, found.lattice, found.corridors, relaxed=False))
        assert (start_values(compiled, asked, found.lattice, found.corridors) is not None) is usable
        assert answer(asked).objective == found.objective


def test_explanation_names_the_line():
    asked = problem(((1, 2), 120.0))
    found = explain(asked, answer(asked, "search"))
    faster = next(a for a in found.actions if (a.lateral, a.mode) == (Lateral.KEEP, Mode.ACCELERATE))
    # 43 m, 22 m/s, 121 m.
    assert (faster.verdict, faster.violation) == (Verdict.SHORT, pytest.approx(44.0))
    assert faster.reason == "from step 2 the ego stops 44.00 m beyond the stop line at 120.00 m"
    assert [window.high_x for window in found.steps[0].lanes[0].windows[:-1]] == [120.0]


def test_explanation_names_the_line_that_leaves_only_shortfalls():
    # Lane 2 is closed at 30 m; in lane 1 a vehicle is 8 m ahead of a cruising ego, 2 m less than is safe.
    content = document(((2,), 30.0), speed_weight=0.0)
    content["vehicles"] = [
        {"id": "sv", "x_m": 8.0, "y_m": 2.0, "speed_mps": 20.0, "lane": 1, "mode": "cruise"}
        | {"lateral_probs": {"left": 0, "keep": 1, "right": 0}}
        | {"longitudinal_probs": {"accelerate": 0, "cruise": 1, "decelerate": 0}}
    ]
    asked = parse_problem(content)
    found = explain(asked, answer(asked, "search"))
    keep = next(a for a in found.actions if (a.lateral, a.mode) == (Lateral.KEEP, Mode.CRUISE))
    # Cruise, then brake and change: 39 m against 48 m.
    assert keep.reason == (
        "sv at step 2 is 1.00 m too near; a stop line (30.00 m) forbids those that keep every distance"
    )
    assert keep.violation == pytest.approx(1.0)


def test_text_and_figure_show_the_line():
    asked = problem(((2,), 30.0), occupancy="swept")
    explanation = explain(asked, answer(asked, "search"))
    text = explanation_text(explanation)
    assert "to   the stop line" in text
    assert "inf" not in text
    assert max(map(len, text.splitlines())) <= 100
    panels = decision_figure(explanation).axes
    words = [{note.get_text() for note in axes.texts} for axes in panels]
    assert "stop line" not in words[0]
    assert "stop line" in words[1]
    assert any("70.00 m beyond the stop line" in word for lane in words for word in lane)


def test_figure_tells_a_line_out_of_view():
    asked = problem(((1, 2), 120.0))
    panels = decision_figure(explain(asked, answer(asked, "search"))).axes
    assert all("stop line at 80.0 m, out of view" in {note.get_text() for note in axes.texts} for axes in panels)


def test_no_window_within_reach_of_a_line():
    # At step 2 the ego is at 36 m at least, and a line at 5 m has closed all that.
    asked = problem(((1, 2), 5.0))
    text = explanation_text(explain(asked, answer(asked, "search")))
    assert "none; the nearest are" in text
    assert "inf" not in text


def test_the_planner_hands_lines_on_and_shows_them():
    asked = problem(((2,), 120.0))
    planner = HmdpPlanner(asked.settings, {})
    scene = Scene(0.0, asked.road, asked.ego, (), asked.stop_lines)
    assert planner.problem(scene).stop_lines == asked.stop_lines
    decision, _ = planner.decide(scene, None)
    assert decision.evidence.forbidden() == tuple(ForbiddenInterval(k, 2, 120.0, 212.0) for k in (1, 2))
    assert '"stop_lines": [{"lanes": [2], "x_m": 120.0}]' in decision.evidence.problem_json()


@pytest.mark.parametrize(("ego_x", "begins", "leaving"), [(0.0, 120.0, 144.0), (130.0, 144.0, None)])
def test_the_merging_room_is_shown_until_the_ego_is_in_it(ego_x, begins, leaving):
    asked = problem(((2,), 120.0))
    lines = (StopLine(frozenset({2}), 120.0, 144.0),)
    scene = Scene(0.0, asked.road, replace(asked.ego, x=ego_x), (), lines)
    decision, _ = HmdpPlanner(asked.settings, {}).decide(scene, None)
    assert [(one.lane, one.x_from, one.leaving_x) for one in decision.evidence.forbidden()] == [
        (2, begins, leaving)
    ] * 2


def follow_plan(asked, found, ahead=0.0):
    step = found.plan[0]
    return replace(asked, ego=replace(asked.ego, x=step.x + ahead, speed=step.speed, lane=step.lane, mode=step.mode))


def audited(asked, following, solver="search"):
    before = answer(asked, solver)
    return audit(following, answer(following, solver), (asked, before))


def test_audit_tells_a_line_that_closed():
    asked = problem(((1, 2), 300.0))
    following = follow_plan(asked, answer(asked, "search"))
    assert audited(asked, following).shifted_feasible
    closed = replace(following, stop_lines=(StopLine(frozenset({2}), 120.0),))
    # The plan cruises on, and the baseline, whose desired speed is 0, brakes: at 59 m, 81 m before rest.
    assert audited(asked, closed).shifted_reason == "stop_line: step 2, 20.00 m beyond the stop line at 120.00 m"
    later = replace(following, stop_lines=(StopLine(frozenset({2}), 59.0),))
    assert audited(asked, later).shifted_reason.startswith("stop_line: step 2, 81.00 m beyond")


def test_audit_tells_what_else_breaks_a_line():
    # Where the plan ends by braking, the baseline cruises, and passes the place where the ego could have come to rest.
    asked = problem(((1, 2), 100.0), speed_weight=0.1, desired_speed_mps=20.0, speed_deadband_mps=1.0)
    found = answer(asked, "search")
    following = follow_plan(asked, found)
    assert shifted(asked, found).modes == (Mode.DECELERATE, Mode.CRUISE)
    assert audited(asked, following).shifted_reason.startswith("baseline: step 2")
    # The next step is planned to end at 17 m at most; an ego 20 m ahead of its plan passes the line in it.
    asked = problem(((1, 2), 29.25), speed=9.0)
    found = answer(asked, "search")
    assert (found.objective, found.status) == (9.0, Status.OPTIMAL)
    assert audited(asked, follow_plan(asked, found, ahead=20.0)).shifted_reason.startswith("tracking: step 1")


def test_fallback_brakes_for_a_line():
    asked = problem(((2,), 50.0))
    branches = answer(asked, "search").branches
    assert braking_demand(asked, branches) == (4.0, "the stop line at 50.00 m")
    assert braking_demand(problem(((2,), 0.0)), branches) == (MAX_BRAKE, "the stop line at 0.00 m")
    assert braking_demand(problem(((1,), 50.0), ((2,), -1.0)), branches) == (2.0, None)


def test_file_form():
    asked = problem(((1, 2), 120.0), ((2,), 90.0), ((1,), 90.0, 114.0))
    assert parse_problem(problem_document(asked)) == asked
    assert asked.stop_lines[2].leaving_x == 114.0
    assert asked.stop_lines[1] == StopLine(frozenset({2}), 90.0)
    without = problem_document(problem())
    assert "stop_lines" not in without
    assert parse_problem(without).stop_lines == ()


def test_mistakes_in_lines_are_all_told():
    content = document(((0, 2), 10.0), ((), 10.0), ((1,), float("nan")), ((3,), 10.0), ((1,), 9.0, 8.0))
    content["stop_lines"][3]["x"] = 1.0
    with pytest.raises(InputError) as caught:
        parse_problem(content)
    paths = {mistake.path for mistake in caught.value.problems}
    assert paths == {
        "stop_lines[0].lanes[0]",
        "stop_lines[1].lanes",
        "stop_lines[2].x_m",
        "stop_lines[3].lanes[0]",
        "stop_lines[3].x",
        "stop_lines[4].leaving_x_m",
    }


# The rule-based planner --------------------------------------------------------------------------------------


def rule_based(*lines, leader=None, step=0):
    road = Road(2, 4.0)
    ego = VehicleState("ego", 0.0, -2.0, 20.0, 2)
    lines = tuple(StopLine(frozenset(lanes), x) for lanes, x in lines)
    scene = Scene(step * 0.15, road, ego, () if leader is None else (leader,), lines)
    planner = PublishedPlanner(0.15, lane_change_time=8.0)
    constant = ConstantPlanner(0.15).decide(scene, None)[0]
    assert constant.command.accel == 0.0
    return planner.decide(scene, planner.initial_memory())[0]


def test_idm_takes_a_line_for_a_leader_that_stands():
    line = rule_based(((1, 2), 60.0))
    standing = rule_based(leader=VehicleState("sv", 64.5, -2.0, 0.0, 2))
    assert line.command.accel == pytest.approx(standing.command.accel)
    assert line.command.accel < 0.0
    free = rule_based().command.accel
    assert rule_based(((1,), 60.0), ((2,), -1.0)).command.accel == free
    # A fast leader before the line does not hide it.
    hidden = rule_based(((1, 2), 60.0), leader=VehicleState("sv", 50.0, -2.0, 20.0, 2))
    assert hidden.command.accel <= line.command.accel


def test_mobil_leaves_a_lane_that_is_closed():
    # Step 3 ends at 0.6 s, when a change may begin; the line is within 95 m.
    assert rule_based(((2,), 90.0), step=3).lateral is Lateral.LEFT
    assert rule_based(((1, 2), 90.0), step=3).lateral is Lateral.KEEP
    assert rule_based(((2,), 100.0), step=3).lateral is Lateral.KEEP
