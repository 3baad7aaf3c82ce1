"""The environments keep Gymnasium's contract, and an episode in one is the run of a study."""

import pytest

import sumo_hmdp
from sumo_hmdp.gym import AgentPlanner

gymnasium = pytest.importorskip("gymnasium", reason="the extra gym is not installed")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from sumo_hmdp.errors import InputError, SumoHmdpError  # noqa: E402
from sumo_hmdp.gym import register  # noqa: E402
from sumo_hmdp.gym.environment import ScenarioEnv  # noqa: E402

KEYS = {"duration_s": 4.0}


def policy(seen):
    """Accelerate below 28 m/s, and change to the left beside a near leader."""
    near = (seen[1:, 1] > 0) & (seen[1:, 1] < 30) & (abs(seen[1:, 2]) < 1)
    return (0 if near.any() else 1, 2 if seen[0, 3] < 28 else 1)


@pytest.mark.parametrize("actions", ["maneuver", "command"])
def test_the_checker_has_nothing_to_say(actions):
    register()
    env = gymnasium.make("sumo_hmdp/Recorded-v0", scenario="case2", keys={"duration_s": 1.5}, period=0.6,
                         actions=actions)  # fmt: skip
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_an_episode_is_the_run_of_its_seed():
    env = ScenarioEnv("highway", keys=KEYS)
    seen, _ = env.reset(seed=3)
    rewards, ended = [], False
    while not ended:
        seen, reward, terminated, truncated, info = env.step(policy(seen))
        rewards.append(reward)
        ended = terminated or truncated
    env.close()
    record = sumo_hmdp.run(sumo_hmdp.scenario("highway", AgentPlanner(policy), seed=3, keys=KEYS))
    assert info["trace_hash"] == record.row["trace_hash"]
    assert (len(rewards), terminated, truncated) == (5, False, True)
    assert all(0.0 < reward <= 1.0 for reward in rewards)


def test_misuse_is_said():
    with pytest.raises(SumoHmdpError, match=r"call reset\(\)"):
        ScenarioEnv("case2", period=0.6).step((1, 1))
    with pytest.raises(InputError, match=r"no such file"):
        ScenarioEnv("highwy")
    with pytest.raises(SumoHmdpError, match="multiple of dt"):
        ScenarioEnv("case2", period=0.5)


def test_an_agent_in_a_file_drives_in_a_study(shell, tmp_path):
    agent = tmp_path / "agent.py"
    agent.write_text(
        "from sumo_hmdp.gym import AgentPlanner\n"
        "planner = AgentPlanner(lambda seen: (1, 2 if seen[0, 3] < 28 else 1), name='mine', period=0.6)\n"
    )
    study = tmp_path / "study.yaml"
    study.write_text(
        "name: agents\ndescription: an agent beside ours\nscenarios: [case2]\nseeds: {first: 0, count: 1}\n"
        f"factors: {{planner: [python, constant], duration_s: [1.5], planners.python.file: [{agent}]}}\n"
    )
    done = shell("study", study, "--out", tmp_path / "out", "--workers", "1")
    assert done.code == 0, done.err
    assert sorted(sumo_hmdp.load(tmp_path / "out").runs["planner"]) == ["constant", "python"]
    missing = shell("run", "case2", "--planner", "python", "--set", "planners.python.file=none.py")
    assert (missing.code, len(missing.err.splitlines())) == (2, 1)
