"""Modes, lateral actions and the rule by which an action changes a maneuver state (docs/formulation.md, eq. 2)."""

from dataclasses import dataclass
from enum import IntEnum


class Mode(IntEnum):
    """Longitudinal mode: the sign of the nominal acceleration."""

    DECELERATE = -1
    CRUISE = 0
    ACCELERATE = 1

    @property
    def label(self) -> str:
        """The name used in files and tables: `decelerate`, `cruise` or `accelerate`."""
        return self.name.lower()


class Lateral(IntEnum):
    """Lateral action: the change of the lane number, which counts from the left."""

    LEFT = -1
    KEEP = 0
    RIGHT = 1

    @property
    def label(self) -> str:
        """The name used in files and tables: `left`, `keep` or `right`."""
        return self.name.lower()


MODE_BY_LABEL = {mode.label: mode for mode in Mode}
LATERAL_BY_LABEL = {lateral.label: lateral for lateral in Lateral}


@dataclass(frozen=True)
class Action:
    """An action of the MDP: a lateral action and a change of the mode by at most one level."""

    lateral: Lateral
    mode_change: int


@dataclass(frozen=True)
class ManeuverState:
    """A state of the MDP: the lane that is intended (1 is leftmost) and the longitudinal mode."""

    lane: int
    mode: Mode


# The paper's order a1..a9; ties between equally likely actions go to the first, so to staying as one is.
ACTIONS = tuple(
    Action(lateral, change) for lateral in (Lateral.KEEP, Lateral.LEFT, Lateral.RIGHT) for change in (0, 1, -1)
)


def maneuver_states(lane_count: int) -> tuple[ManeuverState, ...]:
    """List the 3n states of an n-lane road in the paper's order s1..s3n."""
    return tuple(
        ManeuverState(lane, mode)
        for lane in range(1, lane_count + 1)
        for mode in (Mode.CRUISE, Mode.ACCELERATE, Mode.DECELERATE)
    )


def transition(state: ManeuverState, action: Action, lane_count: int) -> ManeuverState | None:
    """Return the state that an action leads to, or None where the action is not admissible.

    An action is admissible where the lane it leads to exists and the mode stays in {-1, 0, 1}.
    """
    lane = state.lane + action.lateral
    mode = state.mode + action.mode_change
    if not 1 <= lane <= lane_count or not -1 <= mode <= 1:
        return None
    return ManeuverState(lane, Mode(mode))
