"""The paper's instants in a run, and the distance to its numbers, by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.report.case_data import CaseDecision, CaseRun, Motion
from sumo_hmdp.report.case_fit import distance, fitted_values, published_numbers
from sumo_hmdp.report.case_instants import (
    CASE1_DECISIONS,
    CASE1_SNAPSHOTS,
    CASE2_SNAPSHOTS,
    case1_instants,
    case2_instants,
    case2_readings,
)

L, K, R = Lateral.LEFT, Lateral.KEEP, Lateral.RIGHT
ACC, CRU, DEC = Mode.ACCELERATE, Mode.CRUISE, Mode.DECELERATE


def motion(name, x_end, duration, y=None, accel=0.0):
    times = np.arange(0.0, duration + 0.01, 0.05)
    x = np.linspace(0.0, x_end, len(times))
    y = np.zeros(len(times)) if y is None else np.array([y(time) for time in times])
    accels = np.full(len(times), accel)
    return Motion(name, times, x, y, np.full(len(times), 20.0), accels, 4.5, 1.8)


def case_run(events, duration, period, first_lane=2, y=None, ego_end=1400.0, sv1_end=1300.0, status="optimal"):
    """A run that changes its lateral action and mode at some times only: (time, lateral, mode)."""
    lane, mode, decisions = first_lane, CRU, []
    happens = {round(time, 6): (lateral, mode) for time, lateral, mode in events}
    for k in range(round(duration / period) + 1):
        time = round(k * period, 6)
        lateral, mode = happens.get(time, (K, mode))
        lane += lateral
        decisions.append(CaseDecision(time, status, lateral, mode, lane, 0.0, (), (), 0.0))
    motions = {"ego": motion("ego", ego_end, duration, y), "sv1": motion("sv1", sv1_end, duration)}
    configuration = {"name": "by hand", "planners": {"hmdp_mpc": {"speed_weight": 3.0}}, "vehicles": [{"id": "sv1"}]}
    return CaseRun(
        "by_hand", "hmdp_mpc", 0.05, 3, 4.0, 75.0, motions, tuple(decisions), {"contact_count": 0}, {}, configuration
    )


def test_the_papers_instants():
    assert CASE1_SNAPSHOTS == (12.2, 21.0, 23.4, 29.8, 30.6, 41.0)
    assert [round(snapshot - 0.2, 6) for snapshot in CASE1_SNAPSHOTS] == [*CASE1_DECISIONS]
    assert CASE2_SNAPSHOTS == (0.00, 5.85, 12.45, 14.85, 29.25, 36.15)


def test_case1_as_the_paper_has_it_is_at_no_distance():
    run = case_run(
        [(12.0, R, CRU), (20.8, K, ACC), (23.2, K, DEC), (29.6, L, ACC), (30.4, L, ACC), (40.8, K, CRU)], 50.0, 0.8
    )
    assert [instant.ours for instant in case1_instants(run)] == pytest.approx([*CASE1_DECISIONS])
    assert distance(1, run) == pytest.approx(0.0)
    assert [instant.there for instant in case1_instants(run)][2] == "lane 3, decelerate, 20.0 m/s"


def test_what_does_not_happen_is_never_and_far():
    run = case_run([(12.8, R, CRU)], 50.0, 0.8)
    assert [instant.ours for instant in case1_instants(run)] == [12.8, None, None, None, None, None]
    # One period of 0.8 s off, and five times the most.
    assert distance(1, run) == pytest.approx((1.0 + 5 * 20.0) / 6)


CASE2 = [(0.0, K, ACC), (1.2, K, CRU), (6.0, L, CRU), (12.6, K, ACC), (13.2, K, CRU), (15.0, K, DEC), (15.6, K, CRU)]


def returning(time):
    """On the centre of lane 1 (y = 4) until 29.4 s, on that of lane 2 from 36.15 s on."""
    return 4.0 if time < 36.12 else 0.0


def test_case2_by_both_readings():
    early = case_run([*CASE2, (29.4, R, CRU)], 45.0, 0.6, y=returning)
    assert [instant.ours for instant in case2_readings(early)["early"]][-2:] == pytest.approx([29.4, 36.15])
    assert case2_readings(early)["late"][-2].ours is None
    late = case_run([*CASE2, (28.8, K, DEC), (29.4, K, CRU), (36.0, R, CRU)], 45.0, 0.6)
    assert [instant.ours for instant in case2_readings(late)["late"]][-2:] == pytest.approx([28.8, 36.0])
    assert [instant.what for instant in case2_instants(early)][-1] == "is back on the centre of lane 2"
    assert [instant.what for instant in case2_instants(late)][-1] == "begins to return to lane 2"


def test_the_distance_of_case2():
    run = case_run([*CASE2, (29.4, R, CRU)], 45.0, 0.6, y=returning, ego_end=1425.0, sv1_end=1250.0)
    # (a) 0, (b) 0.15, (c) 0.15, (d) 0.15, (e) 0.15, (f) 0 s of a period of 0.6 s; 25 and 50 of 25 m.
    assert distance(2, run) == pytest.approx((4 * 0.25 + 1.0 + 2.0) / 8)
    assert [one.off for one in published_numbers(2, run)][-2:] == pytest.approx([1.0, 2.0])


def test_demands_that_fail_are_far():
    events = [*CASE2, (29.4, R, CRU)]
    good = case_run(events, 45.0, 0.6, y=returning)
    relaxed = case_run(events, 45.0, 0.6, y=returning, status="relaxed")
    assert distance(2, relaxed) == pytest.approx(distance(2, good) + 20.0)
    braking = SimpleNamespace(**vars(good) | {"motions": good.motions | {"sv1": motion("sv1", 1300.0, 45.0, accel=-1)}})
    braking.ego, braking.period, braking.decision_at = good.ego, good.period, good.decision_at
    braking.changes, braking.center_y = good.changes, good.center_y
    assert distance(2, braking) == pytest.approx(distance(2, good) + 20.0)


def test_what_was_fitted_is_told_by_path():
    run = case_run([], 1.2, 0.6)
    fitted = case_run([], 1.2, 0.6)
    fitted.configuration["planners"]["hmdp_mpc"]["speed_weight"] = 4.0
    fitted.configuration["vehicles"][0]["driver"] = {"accel_mps2": 1.0}
    fitted.configuration["name"] = "other"
    run.configuration["vehicles"][0]["driver"] = {"accel_mps2": 2.5}
    assert set(fitted_values(run, fitted)) == {
        ("planners.hmdp_mpc.speed_weight", 3.0, 4.0), ("vehicles[sv1].driver.accel_mps2", 2.5, 1.0),
    }  # fmt: skip
