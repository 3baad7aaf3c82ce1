import pytest

from sumo_hmdp.domain.road import Road


@pytest.mark.parametrize(("lane", "y", "index"), [(1, 4.0, 2), (2, 0.0, 1), (3, -4.0, 0)])
def test_three_lanes_of_four_metres(lane, y, index):
    road = Road(3, 4.0)
    assert road.center_y(lane) == y
    assert road.sumo_index(lane) == index
    assert road.lane_of_sumo_index(index) == lane
    assert road.lane_at(y + 1.9) == road.lane_at(y - 1.9) == lane


def test_beside_the_road_counts_as_the_outermost_lane():
    road = Road(2, 3.5)
    assert road.lane_at(50.0) == 1
    assert road.lane_at(-50.0) == 2
    assert not road.has_lane(0)
    assert not road.has_lane(3)
