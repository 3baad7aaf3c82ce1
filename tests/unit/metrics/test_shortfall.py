"""By how much the safe distance was missed at any instant, by hand."""

import json
import math

import numpy as np
import pandas as pd
import pytest

from sumo_hmdp.domain.distance import DistanceRule, SafeDistance
from sumo_hmdp.domain.occupancy import Occupancy
from sumo_hmdp.domain.road import Road
from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.planned_distances import AuditSettings
from sumo_hmdp.metrics.registry import RunData
from sumo_hmdp.metrics.shortfall import kept_distance

LEFT = 4.0
FIXED = SafeDistance(20.0)


def shortfall(run, decided, vehicles, occupancy=Occupancy.SWEPT, distance=FIXED):
    """The metric of a run; `decided` are times of decisions, `vehicles` whom each kept a distance to."""
    settings = AuditSettings(0.8, distance, Road(3, 4.0), occupancy)
    names = [json.dumps(names) for names in vehicles]
    kept = kept_distance(settings, pd.DataFrame({"time_s": decided, "vehicles_json": names}))
    return METRICS.get("distance_shortfall_max_m").compute(RunData(run.trace, run.decisions, kept=kept))


def test_the_worst_is_at_the_instant_at_which_a_lane_change_begins(run_of):
    # The ego decides for lane 1 at 1 s, 14 m ahead of a car there which it leaves behind by 4 m/s: 20 - 14 are missing
    # at once, nothing at the end of the step of 2 s. Before that it had nothing to do with the car.
    time = np.array([0.0, 1.0, 2.0, 3.0])
    ego = {"x": [0.0, 14.0, 28.0, 42.0], "speed": 14.0, "intended": [2, 2, 1, 1], "lane": 2}
    car = {"x": [-4.0, 0.0, 7.9, 17.9], "speed": 10.0, "lane": 1, "intended": 1, "y": LEFT}
    run = run_of(time, ego=ego, car=car)
    assert shortfall(run, [0.0, 1.0], [["car"], ["car"]]) == pytest.approx(6.0)
    # Whom the plan does not keep a distance to counts for nothing, nor does anybody before the first decision.
    assert shortfall(run, [0.0, 1.0], [["car"], []]) == 0.0
    assert shortfall(run, [2.0], [["car"]]) == 0.0


def test_a_body_in_the_lane_counts_under_swept_only(run_of):
    # The leader intends lane 1, its body is still half in lane 2: 20 - 15 are missing.
    car = {"x": [15.0, 25.0], "intended": 1, "y": [1.9, 1.9]}
    run = run_of([0.0, 1.0], ego={"x": [0.0, 10.0]}, car=car)
    assert shortfall(run, [0.0], [["car"]]) == pytest.approx(5.0)
    assert shortfall(run, [0.0], [["car"]], Occupancy.TARGET) == 0.0


def test_the_rule_and_the_speeds_are_those_of_the_planner(run_of):
    # Between bumpers 2 m and 1 s: 4 + 2 + 10, of 15 m.
    headway = SafeDistance(2.0, DistanceRule.TIME_HEADWAY, 1.0)
    run = run_of([0.0, 1.0], ego={"x": [0.0, 10.0]}, car={"x": [15.0, 25.0]})
    assert shortfall(run, [0.0], [["car"]], distance=headway) == pytest.approx(1.0)


def test_nothing_is_left_of_the_distance_to_a_vehicle_that_is_driven_through(run_of):
    run = run_of([0.0, 1.0], ego={"x": [0.0, 90.0], "speed": 90.0}, car={"x": [45.0, 45.0], "speed": 0.0})
    assert shortfall(run, [0.0], [["car"]]) == 20.0


def test_without_a_safe_distance_it_is_not_defined(run_of):
    run = run_of([0.0, 1.0], ego={"x": [0.0, 10.0]}, car={"x": [15.0, 25.0]})
    assert math.isnan(METRICS.get("distance_shortfall_max_m").compute(run))
