"""The audit of plans against loops over every decision, step and vehicle, in worlds of every rule.

The loops share no code with the audit: distances are worked out from their definitions, and whether the ego's body
has left a lane by following it along the quintic in small steps.
"""

import json
import math

import pytest

from sumo_hmdp.metrics.planned_distances import Claim, audit_run, audit_settings
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import execute

TRAFFIC = {"duration_s": 16.0, "traffic.density_vpkm_per_lane": 35.0, "planners.hmdp_mpc.horizon_steps": 3}
# Bold plans in a wild world, so that there are violations to find.
WILD = {"duration_s": 12.0, "noise_scale": 3.0, "planners.hmdp_mpc.risk_allocation": "individual"}
HEADWAY = {"planners.hmdp_mpc.distance_rule": "time_headway", "planners.hmdp_mpc.time_headway_s": 0.3}
SWEPT = {"planners.hmdp_mpc.occupancy": "swept"}
WORLDS = {
    "fixed and target": ("matched", WILD),
    "fixed and swept": ("matched", {**WILD, **SWEPT}),
    "time headway": ("matched", {**WILD, **HEADWAY}),
    "rss and swept": ("matched", {**WILD, **SWEPT, "planners.hmdp_mpc.distance_rule": "rss"}),
    "traffic": ("highway", TRAFFIC),
    "traffic, all followers": ("highway", {**TRAFFIC, "planners.hmdp_mpc.followers": "all"}),
}


def lane_y(lane, count=3, width=4.0):
    return ((count + 1) / 2 - lane) * width


def is_over(lane, y, body):
    return abs(y - lane_y(lane)) < (4.0 + body) / 2 - 1e-9


def clear_time(done, body, duration):
    """Return the time left until a body that has done a share of a quintic lane change is clear of the old lane [s]."""
    here, count = None, 40000
    for i in range(count + 1):
        t = i / count
        share = 10 * t**3 - 15 * t**4 + 6 * t**5
        if here is None and share >= done - 1e-12:
            here = t
        if 4.0 * share >= (4.0 + body) / 2 - 1e-9:
            return max(0.0, t - here) * duration if here is not None else 0.0
    raise AssertionError


def ego_lanes(row, plan, body, swept, duration, period):
    """Return the lanes that the ego takes up at each step."""
    signs = {"left": -1, "keep": 0, "right": 1}
    lane = plan[0]["lane"] - signs[plan[0]["lateral"]]
    leaving = {}
    if swept:
        for other in (1, 2, 3):
            if other != lane and is_over(other, row.ego_y_m, body):
                done = min(1.0, abs(row.ego_y_m - lane_y(other)) / abs(lane_y(lane) - lane_y(other)))
                leaving[other] = clear_time(done, body, duration)
    lanes = []
    for step in plan:
        leaving = {other: left - period for other, left in leaving.items() if left - period > 1e-3}
        if signs[step["lateral"]]:
            # The lane it enters is no longer one that it leaves.
            leaving.pop(step["lane"], None)
            if swept:
                leaving[lane] = max(clear_time(0.0, body, duration) - period, 1e-2)
        lane = step["lane"]
        lanes.append({lane, *leaving})
    return lanes


def needed(parameters, ego_ahead, ego_speed, ego_length, other):
    """Return the distance between front bumpers that was asked for [m]."""
    rule, constant = parameters["distance_rule"], parameters["safe_distance_m"]
    front = ego_length if ego_ahead else other.length_m
    if rule == "fixed":
        return constant
    if rule == "time_headway":
        return front + constant + parameters["time_headway_s"] * ego_speed
    rear, leader = (other.speed_mps, ego_speed) if ego_ahead else (ego_speed, other.speed_mps)
    rho, accel = parameters["rss_response_time_s"], parameters["rss_accel_max_mps2"]
    reached = rear + rho * accel
    stop = rear * rho + accel * rho**2 / 2 + reached**2 / (2 * parameters["rss_brake_min_mps2"])
    return front + max(0.0, stop - leader**2 / (2 * parameters["rss_brake_max_mps2"]))


def intents(others, told):
    """Return (vehicle, microseconds) -> the lane it intends: as recorded, or where it has been heading."""
    last, found = {}, {}
    for row in others.itertuples():
        lane = row.intended_lane
        if not told:
            place = 2 - row.y_m / 4.0
            before = last.get(row.vehicle_id)
            across = 0.0 if before is None or row.time_s - before[0] > 0.3 else (row.y_m - before[1]) / 0.2
            lane = round(place)
            if across > 0.15:
                lane = math.floor(place + 1e-6)
            if across < -0.15:
                lane = math.ceil(place - 1e-6)
            lane = min(max(lane, 1), 3)
            last[row.vehicle_id] = row.time_s, row.y_m
        found[row.vehicle_id, round(row.time_s * 1e6)] = lane
    return found


def by_loops(record, duration, told):
    """Return (decision, step) -> (observed, least spare distance or None)."""
    parameters, period = record.manifest["parameters"], record.manifest["period_s"]
    swept = parameters["occupancy"] == "swept"
    ego = record.steps[record.steps.vehicle_id == "ego"]
    others = record.steps[record.steps.vehicle_id != "ego"]
    instants = {round(t * 1e6) for t in ego.time_s}
    body, length = ego.width_m.iloc[0], ego.length_m.iloc[0]
    lane_of, at = intents(others, told), {}
    for other in others.itertuples():
        at.setdefault(round(other.time_s * 1e6), []).append(other)
    found = {}
    for row in record.decisions.itertuples():
        plan = json.loads(row.plan_json)
        lanes = ego_lanes(row, plan, body, swept, duration, period) if plan else []
        for step, mine in zip(plan, lanes, strict=True):
            now, spare = round((row.time_s + step["step"] * period) * 1e6), []
            for other in at.get(now, []):
                theirs = {lane_of[other.vehicle_id, now]}
                theirs |= {lane for lane in (1, 2, 3) if swept and is_over(lane, other.y_m, other.width_m)}
                if other.vehicle_id in json.loads(row.vehicles_json) and mine & theirs:
                    ahead = step["x_m"] > other.x_m
                    least = needed(parameters, ahead, step["speed_mps"], length, other)
                    spare.append(abs(step["x_m"] - other.x_m) - least)
            found[row.decision_index, step["step"]] = now in instants, min(spare, default=None)
    return found


@pytest.mark.parametrize("name", WORLDS)
def test_every_planned_step_of_a_run(name):
    scenario, overrides = WORLDS[name]
    compared = violated = 0
    for seed in range(2):
        options = RunOptions("hmdp_mpc", solver="search", seed=seed, risk_level=0.5, overrides=overrides)
        record = execute(load_scenario(find_scenario(scenario), options), detailed=False)
        settings = audit_settings(record.manifest)
        audited = audit_run(record.decisions, record.steps, settings, Claim.PLANNED)
        expected = by_loops(record, settings.lane_change_time, settings.told is None)
        assert len(audited) == len(expected)
        for row in audited.itertuples():
            observed, spare = expected[row.decision_index, row.horizon_step]
            assert row.observed == observed
            if spare is None:
                assert math.isnan(row.distance_m)
                assert not row.violated
            else:
                assert row.distance_m - row.required_m == pytest.approx(spare, abs=1e-9)
                assert row.violated == (spare < -1e-5)
                compared += 1
                violated += row.violated
    assert compared > 50
    # Loops that never see a violation prove little.
    assert violated or scenario == "highway"
