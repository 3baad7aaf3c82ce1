"""The heading of a background vehicle, against its differential equation in steps of a hundred thousandth."""

import math

import numpy as np
import pytest

from sumo_hmdp.sim.bodies import trailing_heading


def fine(heading, course, distance, lever):
    for _ in range(100_000):
        heading += distance / 1e5 / lever * math.sin(course - heading)
    return heading


@pytest.mark.parametrize(
    ("heading", "course", "distance", "lever"),
    # The last two go farther in a step than twice the lever: 40 m/s for 0.2 s, a car's lever of 3.6 m.
    [
        (0.0, 0.1, 2.0, 3.6),
        (0.25, -0.05, 5.0, 9.6),
        (-2.0, 1.0, 1.0, 3.6),
        (0.3, 0.0, 8.0, 3.6),
        (1.0, -0.2, 12.0, 3.6),
    ],
)
def test_it_is_the_equation_s_solution(heading, course, distance, lever):
    (got,) = trailing_heading(*(np.array([value]) for value in (heading, course, distance, lever)))
    assert got == pytest.approx(fine(heading, course, distance, lever), abs=1e-4)


def test_two_short_ways_are_one_long_one():
    heading, course, lever = np.array([0.4]), np.array([0.1]), np.array([3.6])
    halfway = trailing_heading(heading, course, np.array([3.0]), lever)
    whole = trailing_heading(heading, course, np.array([6.0]), lever)
    assert trailing_heading(halfway, course, np.array([3.0]), lever) == pytest.approx(whole, abs=1e-12)


def test_a_fast_vehicle_that_has_changed_lanes_is_straight_again():
    heading = np.array([0.05])
    for _ in range(100):
        heading = trailing_heading(heading, np.zeros(1), np.array([9.0]), np.array([3.6]))
        assert 0.0 <= heading[0] <= 0.05
    assert heading[0] == pytest.approx(0.0, abs=1e-12)
