"""Contacts within a step: by hand, and against shapely at a hundredth of the step as the oracle."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.affinity import rotate, translate
from shapely.geometry import box

from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.sim.contact import Side, Snapshot, Sweep, contacts_between, first_meeting


def vehicle(name="ego", x=0.0, y=0.0, **more):
    return VehicleState(id=name, x=x, y=y, speed=more.pop("speed", 20.0), lane=2, **more)


def polygon(sweep, share):
    """The body in shapely at a share of a step."""
    start, end = sweep
    x, y = start.x + share * (end.x - start.x), start.y + share * (end.y - start.y)
    turn = math.remainder(end.heading - start.heading, 2 * math.pi)
    body = box(-start.length, -start.width / 2, 0.0, start.width / 2)
    return translate(rotate(body, start.heading + share * turn, origin=(0.0, 0.0), use_radians=True), x, y)


def sweeps(turn):
    return st.builds(
        lambda x, y, h, dx, dy, dh, length: Sweep(
            vehicle(x=x, y=y, heading=h, length=length), vehicle(x=x + dx, y=y + dy, heading=h + dh, length=length)
        ),
        st.floats(-15, 15), st.floats(-5, 5), st.floats(-math.pi, math.pi), st.floats(-12, 12), st.floats(-4, 4),
        st.floats(-turn, turn), st.floats(1, 12),
    )  # fmt: skip


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_the_first_meeting_agrees_with_shapely(turn):
    shares = np.linspace(0.0, 1.0, 101)
    met = 0

    @settings(max_examples=100, deadline=None, derandomize=True)
    @given(sweeps(turn), sweeps(turn))
    def check(a, b):
        nonlocal met
        found = first_meeting(a, b)
        areas = [(share, polygon(a, share), polygon(b, share)) for share in shares]
        touching = [share for share, one, two in areas if one.distance(two) == 0.0]
        if found is None:
            assert all(one.intersection(two).area < 1e-4 for _, one, two in areas)
        else:
            met += 1
            assert polygon(a, found.share).distance(polygon(b, found.share)) < 1e-6
            assert all(one.intersection(two).area < 1e-4 for share, one, two in areas if share < found.share - 1e-9)
            assert not touching or touching[0] >= found.share - 1 / 100

    check()
    assert met > 10


def drive(ego, others, dt=1.0, **more):
    """The contacts of a step; each vehicle is (state, dx, dy), None in place of dx for one that is gone."""
    before = tuple(state for state, *_ in others)
    after = tuple(replace(state, x=state.x + dx, y=state.y + dy) for state, dx, dy in others if dx is not None)
    state, dx, dy = ego
    then = replace(state, x=state.x + dx, y=state.y + dy)
    return contacts_between(Snapshot(4.0, state, before), Snapshot(4.0 + dt, then, after), **more)


def test_an_ego_does_not_drive_through_a_car_between_two_instants():
    # 22 m to the rear of a standing car, 40 m/s: at 4.55 s; afterwards the ego is 13.5 m beyond it.
    (contact,) = drive((vehicle(x=0.0, speed=40.0), 40.0, 0.0), [(vehicle("a", x=26.5, speed=0.0), 0.0, 0.0)])
    assert (contact.side, contact.at_fault) == (Side.FRONT, True)
    assert contact.time == pytest.approx(4.55, abs=1e-6)


@pytest.mark.parametrize("gap", np.linspace(0.05, 7.95, 12))
def test_a_front_hit_is_the_egos_fault_however_far_the_step_goes_in(gap):
    (contact,) = drive((vehicle(speed=40.0), 8.0, 0.0), [(vehicle("a", x=4.5 + gap, speed=0.0), 0.0, 0.0)], dt=0.2)
    assert (contact.side, contact.at_fault) == (Side.FRONT, True)
    assert contact.time == pytest.approx(4.0 + gap / 40.0, abs=1e-6)


@pytest.mark.parametrize("gap", [0.0, 1e-9, -1e-9])
def test_touching_is_no_contact_also_after_rounding(gap):
    assert drive((vehicle(), 4.0, 0.0), [(vehicle("a", x=4.5 + gap), 4.0, 0.0)], dt=0.2) == ()
    assert drive((vehicle(), 4.0, 0.0), [(vehicle("a", x=-9.0, y=1.8 + gap), 30.0, 0.0)], dt=0.2) == ()


LEAVING = 0.15  # heading of a vehicle in the middle of a lane change of 4 s at 20 m/s [rad]
CASES = {
    # A leader on its way to the left is clipped at its rear right corner by an ego that drives straight on.
    "leaving leader": (
        (vehicle(speed=30.0), 6.0, 0.0), vehicle("a", x=6.0, y=2.0, heading=LEAVING), 2.0, 0.3, Side.FRONT, True,
    ),
    "the same, not turned": ((vehicle(speed=30.0), 6.0, 0.0), vehicle("a", x=6.0, y=1.4), 2.0, 0.3, Side.FRONT, True),
    "comes over into the ego": ((vehicle(), 4.0, 0.0), vehicle("a", x=1.0, y=2.0), 4.0, -0.4, Side.SIDE, False),
    "comes over before it": ((vehicle(), 4.0, 0.0), vehicle("a", x=4.3, y=2.0), 3.9, -0.4, Side.SIDE, False),
    "the ego comes over": ((vehicle(), 4.0, 0.4), vehicle("a", x=1.0, y=2.0), 4.0, 0.0, Side.SIDE, True),
    "both come over": ((vehicle(), 4.0, 0.2), vehicle("a", x=1.0, y=2.0), 4.0, -0.2, Side.SIDE, True),
    "the ego gives way, the other is faster": (
        (vehicle(), 4.0, -0.2), vehicle("a", x=1.0, y=1.9), 4.0, -0.6, Side.SIDE, False,
    ),
    "exchange of lanes side by side": ((vehicle(), 4.0, 4.0), vehicle("a", x=1.0, y=4.0), 4.0, -4.0, Side.SIDE, True),
    "hit from behind": ((vehicle(), 4.0, 0.0), vehicle("a", x=-5.0), 6.0, 0.0, Side.REAR, False),
    "hit from behind while it changes": ((vehicle(), 4.0, 0.4), vehicle("a", x=-5.0), 6.0, 0.0, Side.REAR, False),
    "driven through from behind": ((vehicle(), 4.0, 0.0), vehicle("a", x=-5.0), 24.0, 0.0, Side.REAR, False),
    "crosses before a standing ego": (
        (vehicle(speed=0.0), 0.0, 0.0), vehicle("a", x=0.5, y=-1.5, heading=math.pi / 2), 0.0, 3.0, Side.SIDE, False,
    ),
    "rolls against the front of a standing ego": (
        (vehicle(speed=0.0), 0.0, 0.0), vehicle("a", x=0.5, y=0.0, heading=math.pi), -1.0, 0.0, Side.FRONT, False,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_side_and_fault_follow_the_motion(name):
    ego, other, dx, dy, side, at_fault = CASES[name]
    (contact,) = drive(ego, [(other, dx, dy)], dt=0.2)
    assert (contact.side, contact.at_fault) == (side, at_fault)


def test_contacts_come_in_the_order_of_time():
    far, near = (vehicle("far", x=30.0, speed=0.0), 0.0, 0.0), (vehicle("near", x=12.0, speed=0.0), 0.0, 0.0)
    assert [contact.other_id for contact in drive((vehicle(), 40.0, 0.0), [far, near])] == ["near", "far"]


@pytest.mark.parametrize(("gap", "met"), [(2.0, True), (16.0, False)])
def test_who_leaves_within_the_step_counts_as_long_as_it_is_on_the_road(gap, met):
    # At 10 m/s it leaves after half of the step; an ego that closes by 20 m/s meets its rear after 0.1 or 0.8 s.
    ego = (vehicle(x=5.5 - gap, speed=30.0), 30.0, 0.0)
    assert bool(drive(ego, [(vehicle("a", x=10.0, speed=10.0), None, 0.0)], x_end=15.0)) is met


def test_who_has_just_come_counts_where_it_is():
    ego = vehicle()
    now = replace(ego, x=40.0)
    behind, inside = vehicle("behind", x=20.0), vehicle("inside", x=42.0)
    met = contacts_between(Snapshot(0.0, ego, ()), Snapshot(1.0, now, (behind, inside)))
    assert [contact.other_id for contact in met] == ["inside"]
