"""Contacts of oriented bodies: by hand, and against shapely as the oracle."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.affinity import rotate, translate
from shapely.geometry import box

from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.sim.contact import Contact, Side, contacts, overlap_depth


def vehicle(name="ego", x=0.0, y=0.0, **more):
    return VehicleState(id=name, x=x, y=y, speed=more.pop("speed", 20.0), lane=2, **more)


def polygon(v):
    """The body in shapely: a box behind the origin, turned about the front bumper, carried to (x, y)."""
    body = box(-v.length, -v.width / 2, 0.0, v.width / 2)
    return translate(rotate(body, v.heading, origin=(0.0, 0.0), use_radians=True), v.x, v.y)


bodies = st.builds(
    lambda x, y, heading, length, width: vehicle(x=x, y=y, heading=heading, length=length, width=width),
    st.floats(-8, 8),
    st.floats(-5, 5),
    st.floats(-math.pi, math.pi),
    st.floats(0.5, 12),
    st.floats(0.5, 3),
)


@settings(max_examples=400, deadline=None, derandomize=True)
@given(bodies, bodies)
def test_contact_agrees_with_shapely(ego, other):
    area = polygon(ego).intersection(polygon(other)).area
    depth = overlap_depth(ego, other)
    if area > 1e-6:
        assert depth > 0.0
        assert len(contacts(ego, [other])) == 1
    elif area == 0.0 and polygon(ego).distance(polygon(other)) > 1e-9:
        assert depth <= 0.0
        assert contacts(ego, [other]) == ()


@settings(max_examples=200, deadline=None, derandomize=True)
@given(bodies, bodies)
def test_depth_is_the_same_from_both_sides(ego, other):
    assert overlap_depth(ego, other) == pytest.approx(overlap_depth(other, ego), abs=1e-9) or (
        overlap_depth(ego, other) <= 0.0 and overlap_depth(other, ego) <= 0.0
    )


def test_bodies_reach_back_from_the_front_bumper():
    # The leader's rear bumper is at 4.6 - 4.5 = 0.1: ahead of the ego's front bumper at 0.
    assert contacts(vehicle(), [vehicle("a", x=4.6)]) == ()
    assert overlap_depth(vehicle(), vehicle("a", x=4.4)) == pytest.approx(0.1)
    assert len(contacts(vehicle(), [vehicle("a", x=4.4)])) == 1


def test_touching_is_no_contact():
    assert contacts(vehicle(), [vehicle("a", x=4.5), vehicle("b", x=0.0, y=1.8)]) == ()


def test_the_order_and_the_names_are_those_given():
    others = [vehicle("b", x=4.0), vehicle("far", x=40.0), vehicle("a", x=-4.0)]
    assert [c.other_id for c in contacts(vehicle(), others)] == ["b", "a"]


TOWARD_THE_LEFT = 0.05
CASES = [
    ("rear-end by the ego", {}, {"x": 4.0}, Side.FRONT, True),
    ("rear-end by the ego, two metres deep in one step", {}, {"x": 2.5}, Side.FRONT, True),
    ("rear-end by the other", {}, {"x": -4.0}, Side.REAR, False),
    ("side by side, the ego keeps its lane", {}, {"y": 1.7, "x": 1.0}, Side.SIDE, False),
    (
        "side by side, the ego changes lanes",
        {"heading": TOWARD_THE_LEFT},
        {"y": 1.7, "x": 1.0},
        Side.SIDE,
        True,
    ),
    ("hit from behind in a lane change", {"heading": TOWARD_THE_LEFT}, {"x": -4.3}, Side.REAR, False),
]


@pytest.mark.parametrize(("ego", "other", "side", "at_fault"), [c[1:] for c in CASES], ids=[c[0] for c in CASES])
def test_side_and_fault(ego, other, side, at_fault):
    (contact,) = contacts(vehicle(**ego), [vehicle("a", **other)])
    assert (contact.side, contact.at_fault) == (side, at_fault)


def test_a_heading_at_standstill_is_no_lane_change():
    (contact,) = contacts(vehicle(speed=0.0, heading=0.05), [vehicle("a", x=1.0, y=1.7)])
    assert contact == Contact("a", Side.SIDE, at_fault=False, time=0.0)
