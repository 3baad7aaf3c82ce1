import numpy as np

from sumo_hmdp.domain.lanes import lanes_at
from sumo_hmdp.domain.road import Road


def test_many_places_have_the_lanes_of_each():
    # On a line between two lanes and beside the road too.
    for road in (Road(1, 3.5), Road(2, 3.5), Road(3, 4.0)):
        y = np.arange(-20.0, 20.0, 0.25)
        assert lanes_at(road, y).tolist() == [road.lane_at(float(one)) for one in y]
