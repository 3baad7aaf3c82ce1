"""Which second lane a body reaches into; three lanes of 4 m, lines at y = 2 and y = -2, bodies 1.8 m wide."""

import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.sim.ghost import body_y_range, ghost_of, image_lane, second_lane

ROAD = Road(lane_count=3, lane_width=4.0)


def vehicle(y, heading=0.0, width=1.8):
    return VehicleState(id="ego", x=50.0, y=y, speed=20.0, lane=1, heading=heading, width=width)


@pytest.mark.parametrize(
    ("y", "lane"), [(4.0, 1), (2.0001, 1), (2.0, 2), (0.0, 2), (-1.9999, 2), (-2.0, 3), (-4.0, 3), (-6.5, 3)]
)
def test_image_lane(y, lane):
    assert image_lane(y, ROAD) == lane


@pytest.mark.parametrize(
    ("y", "lane"),
    [
        (0.0, None),
        (1.1, None),  # the left side just touches the line: 1.1 + 0.9 = 2
        (1.2, 1),
        (2.0, 1),
        (2.1, 2),
        (2.8, 2),
        (2.95, None),
        (-1.2, 3),
        (-2.0, 2),
        (-2.8, 2),
        (5.5, None),  # beyond the left edge of the road there is no lane
    ],
)
def test_second_lane_of_a_straight_body(y, lane):
    assert second_lane(vehicle(y), ROAD) == lane


def test_a_turned_body_leaves_its_rear_in_the_old_lane():
    # Rear bumper at 3 - 4.5 sin(0.1) = 2.551, half width 0.9 cos(0.1) = 0.896: lowest y is 1.655.
    assert body_y_range(vehicle(3.0, heading=0.1)) == pytest.approx((1.655, 3.896), abs=1e-3)
    assert second_lane(vehicle(3.0, heading=0.1), ROAD) == 2
    assert second_lane(vehicle(3.0), ROAD) is None


def test_over_both_lines_the_larger_part_counts():
    assert second_lane(vehicle(0.3, width=4.8), ROAD) == 1
    assert second_lane(vehicle(-0.3, width=4.8), ROAD) == 3


def test_ghost_stands_beside_with_the_same_x_and_speed():
    ghost = ghost_of(vehicle(1.5, heading=0.05), ROAD, None)
    assert (ghost.x, ghost.y, ghost.speed, ghost.heading, ghost.lane) == (50.0, 4.0, 20.0, 0.0, 1)


def test_no_ghost_where_none_is_needed():
    assert ghost_of(vehicle(0.0), ROAD, None) is None


def test_ghost_stays_one_step_longer_but_never_in_the_vehicle():
    assert ghost_of(vehicle(4.0), ROAD, last_lane=2).y == 0.0
    assert ghost_of(vehicle(4.0), ROAD, last_lane=1) is None


def test_ghost_changes_sides_when_the_front_crosses_the_line():
    sides = [ghost_of(vehicle(y), ROAD, 1).lane for y in (1.5, 1.99, 2.01, 2.5)]
    assert sides == [1, 1, 2, 2]
