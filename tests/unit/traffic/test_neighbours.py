"""Who is next to whom, against a search through all vehicles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sumo_hmdp.errors import InputError
from sumo_hmdp.traffic.neighbours import find_neighbours


def test_by_hand():
    #   x:        0    10   20   30
    # lane 1:     .    b    .    d
    # lane 2:     a    b    c    .      b is on its way from lane 1 into lane 2
    near = find_neighbours(np.array([0.0, 10.0, 20.0, 30.0]), np.array([2, 1, 2, 1]), np.array([0, 2, 0, 0]), 3)
    a, b, c, d, nobody = range(5)
    assert near.ahead.tolist() == [[b, d, d, nobody], [b, c, nobody, nobody], [nobody] * 4]
    assert near.behind.tolist() == [[nobody, nobody, b, b], [nobody, a, b, c], [nobody] * 4]
    assert near.rank.tolist() == [0, 1, 2, 3]


def test_a_careless_look_up_of_nobody_fails():
    x = np.array([0.0])
    near = find_neighbours(x, np.array([1]), np.array([0]), 1)
    with pytest.raises(IndexError):
        x[near.ahead[0]]


def test_of_two_ahead_the_one_with_the_nearer_rear_leads():
    # A car of 4.5 m about to enter the lane of a truck of 12 m, its front 10 cm behind the truck's.
    x, lane, second = np.array([30.0, 40.0, 39.9]), np.array([2, 1, 2]), np.array([0, 0, 1])
    assert find_neighbours(x, lane, second, 2, np.array([4.5, 12.0, 4.5])).ahead[0, 0] == 1
    assert find_neighbours(x, lane, second, 2, np.array([4.5, 4.5, 4.5])).ahead[0, 0] == 2
    assert find_neighbours(x, lane, second, 2).ahead[0, 0] == 2


def search(x, lane, second, lanes, i, length):
    """The nearest ones by going through all; of two at the same x the later one is ahead."""
    ahead, behind = len(x), len(x)
    for j in range(len(x)):
        if j == i or lanes not in (lane[j], second[j]):
            continue
        if (x[j], j) > (x[i], i):
            if ahead == len(x) or (x[j] - length[j], x[j], j) < (x[ahead] - length[ahead], x[ahead], ahead):
                ahead = j
        elif behind == len(x) or (x[j], j) > (x[behind], behind):
            behind = j
    return ahead, behind


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 9), st.integers(1, 3), st.sampled_from([0, 0, 1, 2, 3]), st.integers(1, 4)),
        max_size=12,
    ),
)
def test_against_a_search(rows):
    x, lane, second, length = (np.array([row[k] for row in rows], dtype=int) for k in range(4))
    near = find_neighbours(x.astype(float), lane, second, 3, length.astype(float))
    for i in range(len(rows)):
        for row in range(3):
            assert (near.ahead[row, i], near.behind[row, i]) == search(x, lane, second, row + 1, i, length)


@pytest.mark.parametrize(
    ("x", "lane", "second"), [(np.nan, 1, 0), (np.inf, 1, 0), (0.0, 0, 0), (0.0, 4, 0), (0.0, 1, 4), (0.0, 1, -1)]
)
def test_who_is_not_on_the_road_is_named(x, lane, second):
    with pytest.raises(InputError, match=r"vehicle number 1\)"):
        find_neighbours(np.array([5.0, x]), np.array([1, lane]), np.array([0, second]), 3)
