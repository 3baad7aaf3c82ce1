"""Gymnasium environments of this package's worlds (the extra `gym`), and agents as planners.

After `register()`, `gymnasium.make("sumo_hmdp/Highway-v0")` drives in `highway`;
`sumo_hmdp/Recorded-v0` in any scenario by name or path.
"""

from sumo_hmdp.gym.agent import AgentPlanner, maneuver_command, observation

__all__ = ["AgentPlanner", "maneuver_command", "observation", "register"]


def register() -> None:
    """Register the environments with Gymnasium, once.

    Raises:
        errors.SumoHmdpError: Gymnasium is not installed.
    """
    from sumo_hmdp.gym.environment import register_all  # noqa: PLC0415 - the one import of Gymnasium

    register_all()
