"""What holds for every reference."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sumo_hmdp.domain.plan import Command
from sumo_hmdp.domain.road import Road
from sumo_hmdp.vehicle.bicycle import BicycleParameters, from_front_bumper, front_bumper
from sumo_hmdp.vehicle.reference import Reference, follow, sample

PARAMETERS = BicycleParameters()
ROAD = Road(lane_count=3, lane_width=3.5)

states = st.builds(
    lambda y, heading, speed, steering: from_front_bumper(0.0, y, heading, speed, PARAMETERS, steering_angle=steering),
    st.floats(-5, 5),
    st.floats(-0.2, 0.2),
    st.floats(0, 40),
    st.floats(-0.05, 0.05),
)
commands = st.builds(Command, st.integers(1, 3), st.sampled_from([-8.0, -2.0, -0.001, 0.0, 0.001, 2.0]))
limits = st.sampled_from([None, 3.0, 20.0])


def references(state, command, limit) -> Reference:
    return follow(command, state, PARAMETERS, None, road=ROAD, time=1.0, lane_change_time=4.0, max_speed=limit)


@settings(derandomize=True, deadline=None)
@given(states, commands, limits)
def test_the_samples_are_derivatives_of_each_other(state, command, limit):
    reference = references(state, command, limit)
    times = np.linspace(1, 7, 3001)
    h = times[1] - times[0]
    got = sample(reference, times)

    x_change = np.diff(got.x)
    np.testing.assert_allclose(x_change, (got.speed[1:] + got.speed[:-1]) / 2 * h, atol=8 * h**2)
    middle = sample(reference, times[:-1] + h / 2)
    np.testing.assert_allclose(np.diff(got.y), np.tan(middle.heading) * middle.speed * h, atol=2e-5)


@settings(derandomize=True, deadline=None)
@given(states, commands, limits)
def test_it_never_goes_back_nor_faster_than_allowed(state, command, limit):
    got = sample(references(state, command, limit), np.linspace(1, 9, 200))

    assert (np.diff(got.x) >= -1e-9).all()
    assert (got.speed >= 0).all()
    if limit is not None:
        assert (got.speed <= max(limit, got.speed[0])).all()


@settings(derandomize=True, deadline=None)
@given(states, commands, limits)
def test_it_begins_at_the_front_bumper(state, command, limit):
    got = sample(references(state, command, limit), 1.0)

    np.testing.assert_allclose((got.x, got.y), front_bumper(state, PARAMETERS), atol=1e-9)


@settings(derandomize=True, deadline=None)
@given(states, st.integers(1, 3), st.sampled_from([0.0, 2.0]))
def test_who_keeps_moving_arrives_in_the_lane_and_stays(state, lane, accel):
    # From rest at 2 m/s2 the clock has run 2.5 s / 2 when it begins to run with time: 7 s are enough.
    assume(accel > 0 or state.speed > 6.0)
    got = sample(references(state, Command(lane, accel), None), np.linspace(8.0, 30.0, 50))

    np.testing.assert_array_equal(got.y, np.full(50, ROAD.center_y(lane)))
    np.testing.assert_array_equal(got.heading, np.zeros(50))


@settings(derandomize=True, deadline=None)
@given(states, commands, st.lists(st.floats(1.0, 9.0), min_size=1, max_size=5))
def test_cruising_on_by_repeated_commands_is_one_lane_change(state, command, times):
    """Repeating a command at the reference's own states changes nothing across the road."""
    first = references(state, command, None)
    reference = first
    for time in sorted(times):
        at = sample(reference, time)
        # A vehicle that moves along its course, so that dx/dt is the reference's.
        course, speed = float(at.heading), float(at.speed / np.cos(at.heading))
        there = from_front_bumper(float(at.x), float(at.y), course, speed, PARAMETERS)
        reference = follow(command, there, PARAMETERS, reference, road=ROAD, time=time, lane_change_time=4.0)
    later = np.linspace(max(times), 12, 20)

    np.testing.assert_allclose(sample(reference, later).y, sample(first, later).y, atol=1e-6)
