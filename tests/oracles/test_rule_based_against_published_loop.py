"""The run in SUMO against a plain loop over arrays that follows the description of the published rule-based code.

The loop shares nothing with the package: vehicles are columns, steps have the number of the instant at which they
end, and the ego's lane change has a flag, a target and a clock of its own. What it must not share is a reading of the
description either: it once counted SV1's reaction from the decision, as the package did, and both were a step early. So
the published speeds at 7.80 and 7.95 s are pinned beside the numbers of the end.
"""

import numpy as np
import pytest

from sumo_hmdp.scenario.load import find_scenario, load_scenario
from sumo_hmdp.study.run import execute

EGO, SV1, SV2, TRUCK1, TRUCK2 = range(5)
IDS = ("ego", "sv1", "sv2", "truck1", "truck2")
DT, STEPS = 0.15, 300
LENGTHS = np.array([4.5, 4.5, 4.5, 9.0, 9.0])
DECIDE_EVERY, CHANGE_TIME, REACTION_STEPS = 4, 8.0, 12  # 0.6 s, 8 s, 1.8 s


def idm(x, v, me, lead):
    pull = 1.0 - (v[me] / 30.0) ** 6
    if lead is not None:
        space = max(0.1, x[lead] - LENGTHS[lead] - x[me])
        wanted = 2.0 + 1.5 * v[me] + v[me] * (v[me] - v[lead]) / (2.0 * np.sqrt(8.0 * 4.0))
        pull -= (wanted / space) ** 2
    return np.clip(8.0 * pull, -5.0, 8.0)


def lead_and_follower(x, lanes, me, lane):
    mine = [j for j in np.argsort(x) if j != me and lanes[j] == lane]
    front, back = [j for j in mine if x[j] > x[me]], [j for j in mine if x[j] <= x[me]]
    return (front[0] if front else None), (back[-1] if back else None)


def wants_left(x, v, lanes):
    """Tell whether the ego of Case 2 changes from lane 2 to lane 1, the only lane it may change to."""
    lead, follower = lead_and_follower(x, lanes, EGO, 2)
    new_lead, new_follower = lead_and_follower(x, lanes, EGO, 1)
    gain = idm(x, v, EGO, new_lead) - idm(x, v, EGO, lead)
    for who, old, new in ((new_follower, new_lead, EGO), (follower, EGO, lead)):
        if who is not None:
            if idm(x, v, who, new) < -3.0:
                return False
            gain += 0.3 * (idm(x, v, who, new) - idm(x, v, who, old))
    return gain > 0.1


def reaction(x, v, lanes, accelerating, following):
    """Return SV1's acceleration and whether its car-following law is latched."""
    accel = 2.5 if accelerating else 0.0
    lead, _ = lead_and_follower(x, lanes, SV1, 1)
    if lead is None:
        return accel, following
    e = x[lead] - LENGTHS[lead] - x[SV1] - (2.0 + 1.5 * v[SV1])
    following = not (e > 4.0 and v[SV1] <= v[lead]) if following else e < 0.0
    return (np.clip(0.25 * e + 0.9 * (v[lead] - v[SV1]), -3.0, 2.0) if following else accel), following


@pytest.fixture(scope="module")
def loop():
    """Return x, v, y of shape (301, 5), and the steps at whose ends the change has begun and is complete."""
    x, v, y = np.zeros((STEPS + 1, 5)), np.zeros((STEPS + 1, 5)), np.zeros((STEPS + 1, 5))
    x[0], v[0], y[0] = [35, 0, 150, 120, 160], [30, 25, 25, 25, 25], [0, 4, 0, -4, -4]
    lanes = np.array([2, 1, 2, 3, 3])  # the ego's becomes its target lane when its change begins
    begun, complete, clock, following = None, None, 0.0, False
    for n in range(1, STEPS + 1):
        px, pv = x[n - 1], v[n - 1]
        if begun is None and n % DECIDE_EVERY == 0:
            lead, _ = lead_and_follower(px, lanes, EGO, 2)
            if lead is not None and px[lead] - px[EGO] < 95.0 and wants_left(px, pv, lanes):
                begun, lanes[EGO] = n, 1
        a = np.zeros(5)
        a[EGO] = idm(px, pv, EGO, lead_and_follower(px, lanes, EGO, lanes[EGO])[0])
        # The clock starts at the first instant off the lane's centre, begun * DT, and is read at this step's beginning.
        accelerating = begun is not None and (n - 1) - begun >= REACTION_STEPS
        a[SV1], following = reaction(px, pv, lanes, accelerating, following)
        v[n] = np.maximum(0.0, pv + DT * a)
        v[n, SV1] = min(v[n, SV1], 38.0)
        x[n] = px + DT * v[n]
        y[n] = y[n - 1]
        if begun is not None and complete is None:
            clock += DT
            p = min(clock / CHANGE_TIME, 1.0)
            y[n, EGO] = 4.0 * (10 * p**3 - 15 * p**4 + 6 * p**5)
            complete = n if p == 1.0 else None
    return x, v, y, begun, complete


@pytest.fixture(scope="module")
def steps():
    record = execute(load_scenario(find_scenario("case2_rule_based")))
    assert record.status == "completed", record.reason
    return record.steps


def test_the_loop_gives_the_published_numbers(loop):
    x, v, _, begun, complete = loop
    assert begun * DT == pytest.approx(6.0)
    assert complete * DT == pytest.approx(13.95)
    assert x[-1, EGO] == pytest.approx(1375.3, abs=0.05)
    assert x[-1, SV1] == pytest.approx(1323.8, abs=0.05)
    assert v[:, SV1].max() == pytest.approx(36.25, abs=0.005)
    assert np.diff(v[:, SV1]).min() / DT == pytest.approx(-3.0)
    # Published: still 25.0 m/s at 7.80 s, and rising from there.
    assert v[52, SV1] == 25.0
    assert v[53, SV1] == pytest.approx(25.375)


@pytest.mark.parametrize(("column", "quantity"), [("x_m", 0), ("speed_mps", 1), ("y_m", 2)])
def test_every_vehicle_at_every_step(loop, steps, column, quantity):
    table = steps.pivot(index="step", columns="vehicle_id", values=column)[list(IDS)]
    assert table.shape == (STEPS + 1, 5)
    np.testing.assert_allclose(table.to_numpy(), loop[quantity], rtol=0.0, atol=1e-9)
