"""The oracle's risk shares, occupancy, distances and stopping against arithmetic by hand."""

import math

import pytest


def tiny(*vehicles, lanes=2, lane=1, y=2.0, speed=20.0, mode="cruise", **planner):
    """Steps of 1 s, 2 m/s2, lanes of 4 m (centres at 2 and -2), z = 0 (a risk of one half), an ego at 0."""
    settings = {
        "period_s": 1.0,
        "horizon_steps": 1,
        "accel_mps2": 2.0,
        "speed_min_mps": 0.0,
        "speed_max_mps": 40.0,
        "safe_distance_m": 10.0,
        "risk_level": 0.5,
        "risk_allocation": "individual",
        "sequence_threshold": 1e-6,
        "maneuver_cost": [[6, 5, 6], [2, 0, 2], [11, 9, 11]],
        "speed_weight": 0.0,
        "desired_speed_mps": 20.0,
        "speed_deadband_mps": 1.0,
        "lane_weight": 0.0,
        "goal_lane": None,
        "terminal_weight": 0.0,
        "forbidden_lanes": [],
    }
    return {
        "lanes": {"count": lanes, "width_m": 4.0},
        "planner": settings | planner,
        "ego": {"x_m": 0.0, "y_m": y, "speed_mps": speed, "lane": lane, "mode": mode},
        "vehicles": [{"id": f"sv{n}"} | vehicle for n, vehicle in enumerate(vehicles, start=1)],
    }


def car(x, speed=20.0, lane=1, y=2.0, **other):
    """A cruising vehicle that keeps its lane."""
    return {
        "x_m": x,
        "y_m": y,
        "speed_mps": speed,
        "lane": lane,
        "mode": "cruise",
        "lateral_probs": {"left": 0.0, "keep": 1.0, "right": 0.0},
        "longitudinal_probs": {"accelerate": 0.0, "cruise": 1.0, "decelerate": 0.0},
    } | other


def undecided(x):
    """A vehicle with three sequences a step: 0.1, 0.8, 0.1."""
    return car(x, longitudinal_probs={"accelerate": 0.1, "cruise": 0.8, "decelerate": 0.1})


# Risk --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("probs", "budget", "shares"),
    [
        # Nobody reaches 1/2: everybody costs 0.01.
        ([0.5, 0.3, 0.2], 0.03, [0.02, 1 / 30, 0.05]),
        # The least likely is full at a cost of 0.01; the others share the 0.08 that is left.
        ([0.5, 0.48, 0.02], 0.09, [0.08, 0.04 / 0.48, 0.5]),
        # More than all of them can cost.
        ([0.6, 0.4], 0.6, [0.5, 0.5]),
        ([1.0], 0.05, [0.05]),
    ],
)
def test_water_filling(brute_force, probs, budget, shares):
    assert brute_force.water_fill(probs, budget) == pytest.approx(shares)


def test_mixture_and_accounting(brute_force):
    # Two vehicles, one step, eps 0.2: 0.1 each; nothing pruned, so each of three branches may cost 0.1 / 3.
    problem = tiny(undecided(100.0), undecided(200.0), risk_level=0.2, risk_allocation="mixture")
    sequences = brute_force.retained_sequences(problem, problem["vehicles"][0])
    assert [prob for prob, _ in sequences] == pytest.approx([0.8, 0.1, 0.1])
    assert brute_force.branch_risks(problem, sequences) == pytest.approx([0.1 / 3 / 0.8, 1 / 3, 1 / 3])
    # Only the likeliest is kept: 0.2 is pruned, more than the 0.1 there are.
    problem["planner"]["sequence_threshold"] = 0.5
    assert brute_force.solve(problem)["status"] == "error"
    # One vehicle and eps 0.3: 0.3 - 0.2 is left, over one step.
    problem["vehicles"].pop()
    problem["planner"] |= {"risk_level": 0.3, "risk_allocation": "uniform", "account_pruned": True}
    sequences = brute_force.retained_sequences(problem, problem["vehicles"][0])
    assert brute_force.branch_risks(problem, sequences) == pytest.approx([0.1])


def test_action_threshold(brute_force):
    problem = tiny(undecided(100.0), action_threshold=0.2)
    answer = brute_force.solve(problem)
    assert answer["branches"] == {"sv1": 1}
    assert answer["pruned_prob"]["sv1"] == pytest.approx(0.2)
    # Where every sequence has an action below it, the likeliest of all is kept.
    problem["planner"]["action_threshold"] = 0.9
    assert brute_force.solve(problem)["branches"] == {"sv1": 1}


# Occupancy ---------------------------------------------------------------------------------------------------


def test_lateral_mean(brute_force):
    # K1 = 0.5, K2 = 1, T = 1: y+ = 0.75 y + 0.25 y_ref - 0.5 v_y. From 2 to lane 2 at -2, measured v_y -0.4.
    problem = tiny(lateral_gain_k1_ps2=0.5, lateral_gain_k2_ps=1.0)
    assert brute_force.lateral_motion(problem, 2.0, -0.4, 1, 2) == pytest.approx((1.2, -0.8))
    assert brute_force.lateral_motion(problem, 1.2, -0.8, 0, 2) == (1.2, 0.0)


def test_a_vehicle_takes_up_the_lanes_under_it(brute_force):
    # Lane 1 is y > 0; a body of 1.8 m is over lane 2 as long as y < 0.9.
    problem = tiny(occupancy="swept", horizon_steps=2, lateral_gain_k1_ps2=0.5, lateral_gain_k2_ps=0.0)
    path = brute_force.branch_path(problem, car(50.0, y=0.8), [(0, 0), (1, 0)])
    assert [lanes for lanes, _, _ in path] == [{1, 2}, {1, 2}, {1, 2}]
    path = brute_force.branch_path(problem, car(50.0), [(0, 0), (1, 0)])
    assert [lanes for lanes, _, _ in path] == [{1}, {1}, {1, 2}]
    problem["planner"]["occupancy"] = "target"
    path = brute_force.branch_path(problem, car(50.0), [(0, 0), (1, 0)])
    assert [lanes for lanes, _, _ in path] == [{1}, {1}, {2}]


def test_a_vehicle_that_changes_lanes_takes_its_time(brute_force):
    # Lane 1 is y > 0, its centre at 2; 1 m a step of 1 s, and a body of 1.8 m clears the line at -0.9 m.
    problem = tiny(occupancy="swept", horizon_steps=5)
    actions = [(1, 0), (0, 0), (0, 0), (0, 0), (0, 0)]
    places = brute_force.prediction.lateral_places(problem, car(50.0), [1, 0, 0, 0, 0])
    assert places == [2.0, 1.0, 0.0, -1.0, -2.0, -2.0]
    path = brute_force.branch_path(problem, car(50.0), actions)
    assert [lanes for lanes, _, _ in path] == [{1}, {1, 2}, {1, 2}, {2}, {2}, {2}]
    # Half-way it goes on; a little off the centre it steers back.
    half_way = brute_force.prediction.lateral_places(problem, car(50.0, y=-0.5), [0, 0, 0])
    assert half_way == [-0.5, 0.5, 1.5, 2.0]
    keeping = brute_force.prediction.lateral_places(problem, car(50.0, y=1.4), [0, 0])
    assert keeping == pytest.approx([1.4, 2.0 - 0.6 * math.exp(-0.5), 2.0 - 0.6 * math.exp(-1.0)])


def test_a_body_counts_as_wider_by_its_margin(brute_force):
    # 0.9 + 2 sigma reaches the line 2 m away from the centre for sigma > 0.55 m.
    problem = tiny(occupancy="swept", horizon_steps=1)
    for variance, lanes in ((0.54**2, {1}), (0.56**2, {1, 2})):
        vehicle = car(50.0) | {"lateral_var_m2": 0.0, "process_lateral_var_m2": variance}
        assert brute_force.branch_path(problem, vehicle, [(0, 0)], z=2.0, z_now=2.0)[1][0] == lanes
        now = car(50.0) | {"lateral_var_m2": variance}
        assert brute_force.branch_path(problem, now, [(0, 0)], z=0.0, z_now=2.0)[0][0] == lanes


def ego_lanes(brute_force, problem, laterals):
    states = brute_force.follow(problem, laterals, [0] * len(laterals))
    return [set(state.lanes) for state in states]


def test_the_ego_takes_up_the_lane_it_leaves(brute_force):
    # y(p_c) = (4 + 1.8) / 8 = 0.725, so p_c = 0.6219: a change of 5 s clears after 3.11 s, in the fourth step.
    problem = tiny(occupancy="swept", lane_change_time_s=5.0, horizon_steps=5)
    assert ego_lanes(brute_force, problem, [1, 0, 0, 0, 0]) == [{1}, {1, 2}, {1, 2}, {1, 2}, {2}, {2}]
    # Back at once: lane 1 is intended again, and lane 2 is left for three step ends.
    assert ego_lanes(brute_force, problem, [1, -1, 0, 0, 0]) == [{1}, {1, 2}, {1, 2}, {1, 2}, {1, 2}, {1}]
    # A change of 1 s clears within the step, and still takes up the old lane at its end.
    problem["planner"]["lane_change_time_s"] = 1.0
    assert ego_lanes(brute_force, problem, [1, 0, 0, 0, 0]) == [{1}, {1, 2}, {2}, {2}, {2}, {2}]


def test_a_change_under_way(brute_force):
    # Halfway at p_s = 0.5: (0.6219 - 0.5) * 5 s = 0.61 s are left, within the first step; nearly at the start
    # (y = 1.966, 0.0085 done, p_s = 0.1) 2.61 s are left: two more step ends.
    problem = tiny(occupancy="swept", lane=2, y=0.0, lane_change_time_s=5.0, horizon_steps=3)
    assert ego_lanes(brute_force, problem, [0, 0, 0]) == [{1, 2}, {2}, {2}, {2}]
    problem["ego"]["y_m"] = 1.966
    assert ego_lanes(brute_force, problem, [0, 0, 0]) == [{1, 2}, {1, 2}, {1, 2}, {2}]


# Distances and stopping --------------------------------------------------------------------------------------


def test_distances(brute_force):
    problem = tiny(safe_distance_m=2.0, distance_rule="time_headway", time_headway_s=1.5)
    problem["ego"]["length_m"] = 12.0
    branch = brute_force.prediction.BranchStep({1}, 0.0, {1}, 50.0, 10.0, 5.0, 0.0)
    assert brute_force.distance(problem, 20.0, branch, ego_is_ahead=False) == pytest.approx(5 + 2 + 30)
    assert brute_force.distance(problem, 20.0, branch, ego_is_ahead=True) == pytest.approx(12 + 2 + 30)
    # Behind: 20 * 0.5 + 2 * 0.25 / 2 + 21^2 / 8 - 10^2 / 16 = 10 + 0.25 + 55.125 - 6.25.
    problem["planner"]["distance_rule"] = "rss"
    assert brute_force.distance(problem, 20.0, branch, ego_is_ahead=False) == pytest.approx(5 + 59.125)
    # Ahead: 5 + 0.25 + 11^2 / 8 - 25 is below 0.
    assert brute_force.distance(problem, 20.0, branch, ego_is_ahead=True) == pytest.approx(12)


def test_the_ego_stops_within_a_step(brute_force):
    stopping = tiny(speed=1.0, stopping=True)
    assert brute_force.ego_motion(stopping, 5.0, 1.0, -1) == (5.25, 0.0)
    assert brute_force.ego_motion(stopping, 5.25, 0.0, -1) == (5.25, 0.0)
    assert brute_force.ego_motion(stopping, 5.0, 2.0, -1) == (6.0, 0.0)
    assert brute_force.ego_motion(tiny(speed=1.0), 5.0, 1.0, -1) is None
    assert brute_force.ego_motion(tiny(speed=1.0, stopping=True, speed_min_mps=0.5), 5.0, 1.0, -1) is None
