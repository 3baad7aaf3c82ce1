"""What an agent sees and does, as arrays and numbers, and an agent as a planner; needs no Gymnasium."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.plan import Command, Decision
from sumo_hmdp.domain.scene import Scene
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.sim.episode import commanded

# The columns of an observation, one row a vehicle, the ego first.
COLUMNS = ("present", "x_m", "y_m", "speed_mps", "lateral_speed_mps", "length_m")
# Bounds of each column that no vehicle on a road of this package exceeds.
LOW = np.array([0.0, -1e5, -100.0, -200.0, -100.0, 0.0], dtype=np.float32)
HIGH = np.array([1.0, 1e5, 100.0, 200.0, 100.0, 100.0], dtype=np.float32)
ActionKind = Literal["maneuver", "command"]


def observation(scene: Scene, neighbours: int) -> NDArray[np.float32]:
    """Return the ego and its nearest neighbours along the road, shape (1 + neighbours, 6), nearest first.

    The columns are `COLUMNS`. A neighbour's x_m, y_m, speed_mps and lateral_speed_mps are relative to the ego; those of
    the ego are 0, its y about the road's middle, its own speeds. Rows without a vehicle are zero, `present` too.

    Args:
        scene: as measured.
        neighbours: how many are told of.
    """
    ego = scene.ego
    rows = np.zeros((1 + neighbours, len(COLUMNS)), dtype=np.float32)
    rows[0] = 1.0, 0.0, ego.y, ego.speed, ego.lateral_speed, ego.length
    near = sorted(scene.others, key=lambda other: (abs(other.x - ego.x), other.id))[:neighbours]
    for row, other in zip(rows[1:], near, strict=False):
        row[:] = (
            1.0,
            other.x - ego.x,
            other.y - ego.y,
            other.speed - ego.speed,
            other.lateral_speed - ego.lateral_speed,
            other.length,
        )
    return rows


def maneuver_command(action: Any, scene: Scene, accel: float) -> Command:  # noqa: ANN401 - two whole numbers
    """Return the command of an action (lateral, mode), each 0, 1 or 2; at the road's edge a change keeps the lane.

    Args:
        action: lateral 0 left, 1 keep, 2 right; mode 0 decelerate, 1 cruise, 2 accelerate.
        scene: now.
        accel: magnitude of the acceleration of a mode [m/s2].
    """
    lateral, mode = int(action[0]), int(action[1])
    if lateral not in {0, 1, 2} or mode not in {0, 1, 2}:
        raise InputError([Problem("action", f"must be two of 0, 1, 2 (lateral, mode), got {action!r}")])
    lane = scene.ego.lane + lateral - 1
    return Command(lane if scene.road.has_lane(lane) else scene.ego.lane, (mode - 1) * accel)


def lane_command(action: Any, scene: Scene, accel_max: float) -> Command:  # noqa: ANN401 - two numbers
    """Return the command of an action (lane, acceleration), each in -1..1 as continuous agents prefer.

    Args:
        action: lane from -1, the leftmost, to 1, the rightmost; acceleration as a part of its limit.
        scene: now.
        accel_max: the limit [m/s2].
    """
    lane, accel = float(action[0]), float(action[1])
    if not (np.isfinite(lane) and np.isfinite(accel)):
        raise InputError([Problem("action", f"must be two finite numbers in -1..1, got {action!r}")])
    lane, accel = min(max(lane, -1.0), 1.0), min(max(accel, -1.0), 1.0)
    count = scene.road.lane_count
    return Command(1 + min(count - 1, int((lane + 1.0) / 2.0 * count)), accel * accel_max)


def decision_of(action: Any, scene: Scene, kind: ActionKind, accel: float) -> Decision:  # noqa: ANN401
    """Return the decision that an action of an environment stands for."""
    make = maneuver_command if kind == "maneuver" else lane_command
    return commanded(make(action, scene, accel), scene)


@dataclass(frozen=True)
class AgentPlanner:
    """An agent as a planner: what drives in an environment drives in scenarios, studies and reports.

    Attributes:
        policy: from an observation to an action; it must not be random and keep nothing from call to call.
        name: in tables.
        period: time between two decisions [s], that of the environment.
        neighbours: in the observation.
        actions: `maneuver` or `command`.
        accel: of a mode, or the largest of a command [m/s2].
    """

    policy: Callable[[NDArray[np.float32]], Any]
    name: str = "agent"
    period: float = 0.8
    neighbours: int = 8
    actions: ActionKind = "maneuver"
    accel: float = 2.0

    def initial_memory(self) -> None:
        """Return nothing: an agent remembers nothing."""

    def decide(self, scene: Scene, memory: None) -> tuple[Decision, None]:
        """Answer a scene with the policy's action."""
        return decision_of(self.policy(observation(scene, self.neighbours)), scene, self.actions, self.accel), memory
