"""The transition rule against the published table, cell by cell."""

import pytest

from sumo_hmdp.domain.maneuver import ACTIONS, Action, Lateral, ManeuverState, Mode, maneuver_states, transition

# The published table "state transition mapping": rows s1..s9, columns a1..a9, 0 for an infeasible action.
PUBLISHED = """
1 2 3 0 0 0 4 5 6
2 0 1 0 0 0 5 0 4
3 1 0 0 0 0 6 4 0
4 5 6 1 2 3 7 8 9
5 0 4 2 0 1 8 0 7
6 4 0 3 1 0 9 7 0
7 8 9 4 5 6 0 0 0
8 0 7 5 0 4 0 0 0
9 7 0 6 4 0 0 0 0
"""
CELLS = [
    (row, column, int(cell))
    for row, line in enumerate(PUBLISHED.split("\n")[1:-1])
    for column, cell in enumerate(line.split())
]


@pytest.mark.parametrize(("row", "column", "successor"), CELLS)
def test_every_cell_of_the_published_table(row, column, successor):
    states = maneuver_states(3)
    expected = states[successor - 1] if successor else None
    assert transition(states[row], ACTIONS[column], 3) == expected


def test_the_table_has_81_cells():
    assert len(CELLS) == 81


def test_actions_come_in_the_published_order():
    symbols = [(0, 0), (0, 1), (0, -1), (-1, 0), (-1, 1), (-1, -1), (1, 0), (1, 1), (1, -1)]
    assert [(a.lateral, a.mode_change) for a in ACTIONS] == symbols


def test_one_lane_has_no_lane_changes():
    state = ManeuverState(1, Mode.CRUISE)
    assert transition(state, Action(Lateral.LEFT, 0), 1) is None
    assert transition(state, Action(Lateral.RIGHT, 0), 1) is None
    assert len(maneuver_states(1)) == 3
