"""The environments; the one file that imports Gymnasium."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp import Session
from sumo_hmdp import scenario as read_scenario
from sumo_hmdp.decision.contract import steps_per_decision
from sumo_hmdp.domain.plan import Decision
from sumo_hmdp.domain.scene import Scene
from sumo_hmdp.errors import InputError, Problem, SumoHmdpError
from sumo_hmdp.gym.agent import COLUMNS, HIGH, LOW, ActionKind, AgentPlanner, decision_of, observation
from sumo_hmdp.sim.episode import Moment

try:
    import gymnasium
except ImportError as error:
    raise SumoHmdpError(
        "the environments need Gymnasium, which is not installed; pip install sumo-hmdp[gym]"
    ) from error

_SEED_MAX = 2**31 - 1
Reward = Callable[[Moment, Decision, Moment], float]


def default_reward(before: Moment, decision: Decision, after: Moment) -> float:
    """Return the default reward of one action.

    It is the mean speed driven as a part of 30 m/s (at most 1), less 0.1 for a lane change that is begun, less 10 for a
    contact. 30 m/s is an ordinary speed on motorways; a contact costs what ten seconds of driving earn or more.
    """
    duration = after.scene.time - before.scene.time
    speed = (after.scene.ego.x - before.scene.ego.x) / duration if duration else 0.0
    changes = decision.command.lane != before.scene.ego.lane
    return float(min(speed / 30.0, 1.0) - 0.1 * changes - 10.0 * bool(after.contacts))


class ScenarioEnv(gymnasium.Env[NDArray[np.float32], Any]):
    """One scenario as an environment; an action holds for `period` seconds.

    Observations are `agent.observation`, arrays of shape (1 + neighbours, 6). Actions are maneuvers, two whole
    numbers (lateral, mode), or commands, two numbers in -1..1 (lane, acceleration). An episode is terminated by a
    contact or by the scenario's goal, and truncated by its duration. `reset(seed=n)` gives the scenario of seed n, as a
    study has it; without a seed, each episode draws its own from the environment's generator.

    One process can have one world open: environments side by side run in processes (`AsyncVectorEnv`).
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own attribute

    def __init__(
        self,
        scenario: str | Path = "highway",
        *,
        keys: Mapping[str, Any] | None = None,
        period: float = 0.8,
        neighbours: int = 8,
        actions: ActionKind = "maneuver",
        accel: float = 2.0,
        reward: Reward = default_reward,
    ) -> None:
        """Read the scenario once, so that its mistakes are told now.

        Args:
            scenario: its name or file.
            keys: values that take the place of the scenario's, by path.
            period: how long an action holds, a multiple of the scenario's dt_s [s].
            neighbours: in an observation.
            actions: `maneuver` or `command`.
            accel: of a mode, or the largest of a command [m/s2].
            reward: from the instant before, the decision and the instant after.

        Raises:
            InputError: with every mistake in the scenario or the arguments.
            decision.contract.PlannerError: the period is no multiple of dt_s.
        """
        if actions not in {"maneuver", "command"}:
            raise InputError([Problem("actions", f"must be 'maneuver' or 'command', got {actions!r}")])
        self._scenario, self._keys, self._reward = scenario, dict(keys or {}), reward
        self._agent = AgentPlanner(_no_policy, "agent", period, neighbours, actions, accel)
        self._every = steps_per_decision(self._agent, self._read(0).episode.dt)
        self._session: Session | None = None
        shape = (1 + neighbours, len(COLUMNS))
        self.observation_space = gymnasium.spaces.Box(
            np.broadcast_to(LOW, shape), np.broadcast_to(HIGH, shape), shape, np.float32
        )
        self.action_space = (
            gymnasium.spaces.MultiDiscrete([3, 3])
            if actions == "maneuver"
            else gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: of the scenario, 0..2^31 - 1; None draws one.
            options: none are known.
        """
        if options:
            raise InputError([Problem("options", f"must be empty, got {sorted(options)}")])
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(_SEED_MAX)) if seed is None else seed
        self.close()
        self._session = Session(self._read(drawn))
        self._session.reset()
        return self._seen(), {"seed": drawn}

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Carry out an action for one period, or until the episode ends."""
        session = self._session
        if session is None:
            raise SumoHmdpError("the environment must be reset before it is stepped; call reset()")
        before, agent = session.now, self._agent
        decision = decision_of(action, session.perceived(), agent.actions, agent.accel)
        after = session.step(decision)
        for _ in range(self._every - 1):
            if session.ended:
                break
            after = session.step()
        terminated = bool(after.contacts or after.goal_reached)
        info: dict[str, Any] = {"time_s": after.scene.time}
        if session.ended:
            info["trace_hash"] = session.trace_hash
            info["contact"] = bool(after.contacts)
        return self._seen(), self._reward(before, decision, after), terminated, session.ended and not terminated, info

    def close(self) -> None:
        """Close the world."""
        if self._session is not None:
            self._session.close()
            self._session = None

    def scene(self) -> Scene:
        """Return the present scene, all vehicles in their true places."""
        if self._session is None:
            raise SumoHmdpError("the environment must be reset before it is looked at; call reset()")
        return self._session.now.scene

    def _read(self, seed: int) -> Any:  # noqa: ANN401 - a ready run
        return read_scenario(self._scenario, self._agent, seed=seed, keys=self._keys)

    def _seen(self) -> NDArray[np.float32]:
        assert self._session is not None  # noqa: S101 - only called while one is open
        return observation(self._session.perceived(), self._agent.neighbours)


def _no_policy(seen: NDArray[np.float32]) -> Any:  # noqa: ANN401
    """Keep the lane and the speed, where nobody else decides."""
    del seen
    return (1, 1)


def register_all() -> None:
    """Register `sumo_hmdp/Highway-v0` and `sumo_hmdp/Recorded-v0` with Gymnasium, once."""
    entry = f"{__name__}:ScenarioEnv"
    for name in ("sumo_hmdp/Highway-v0", "sumo_hmdp/Recorded-v0"):
        if name not in gymnasium.registry:
            gymnasium.register(name, entry_point=entry)
