"""Train a small agent by a cross-entropy method, and put it beside a planner in a study.

    python analysis/20_small_agent.py OUT [GENERATIONS] [CANDIDATES]
    sumo-hmdp study OUT/study.yaml --out OUT/results

The agent keeps its lane and accelerates, cruises or brakes by a linear score of its speed, the gap ahead and the
closing speed. A generation draws candidates around a mean, drives each in the same seed, and moves the mean and the
spread to those of the best quarter. Training seeds begin at 1000; the study uses others.
"""

import sys
from pathlib import Path

import numpy as np

from sumo_hmdp.gym.environment import ScenarioEnv

POLICY = '''"""A linear policy, trained by analysis/20_small_agent.py."""

import numpy as np

from sumo_hmdp.gym import AgentPlanner

WEIGHTS = np.array({weights})


def policy(seen):
    """Return (lateral, mode): keep the lane; the mode by the sign of a linear score, cruise near zero."""
    others = seen[1:]
    ahead = others[(others[:, 0] > 0) & (others[:, 1] > 0) & (abs(others[:, 2]) < 2.0)]
    near = ahead[ahead[:, 1].argmin()] if len(ahead) else np.array([1.0, 150.0, 0.0, 0.0, 0.0, 4.5])
    features = np.array([1.0, (seen[0, 3] - 25.0) / 10.0, (near[1] - near[5]) / 50.0, near[3] / 5.0])
    score = WEIGHTS @ features
    return (1, 1 + int(score > 0.3) - int(score < -0.3))


planner = AgentPlanner(policy, name="small_agent")
'''
STUDY = """name: small_agent
description: A trained linear policy beside rules.
scenarios: [highway]
factors:
  planner: [python, idm_mobil]
  planners.python.file: [{file}]
  duration_s: [20.0]
seeds: {{first: 0, count: 6}}
"""


def planner_text(weights: np.ndarray) -> str:
    """Return the agent's file."""
    return POLICY.format(weights=[float(value) for value in weights])


def episode_return(env: ScenarioEnv, weights: np.ndarray, seed: int) -> float:
    """Return the sum of rewards of one episode."""
    space: dict = {}
    exec(planner_text(weights), space)  # noqa: S102 - the very text that is written, so that both are the same
    seen, _ = env.reset(seed=seed)
    total, ended = 0.0, False
    while not ended:
        seen, reward, terminated, truncated, _ = env.step(space["policy"](seen))
        total, ended = total + reward, terminated or truncated
    return total


def train(env: ScenarioEnv, generations: int, candidates: int) -> np.ndarray:
    """Return the mean weights after some generations."""
    rng = np.random.default_rng(1)
    mean, spread = np.zeros(4), np.ones(4)
    for generation in range(generations):
        drawn = mean + spread * rng.standard_normal((candidates, 4))
        returns = np.array([episode_return(env, weights, 1000 + generation) for weights in drawn])
        best = drawn[np.argsort(-returns)[: max(2, candidates // 4)]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.1
        print(f"generation {generation}: best {returns.max():.2f}, median {np.median(returns):.2f}")
    return mean


def main(out: Path, generations: int = 8, candidates: int = 16) -> None:
    """Train and write the agent and the study."""
    out.mkdir(parents=True, exist_ok=True)
    env = ScenarioEnv("highway", keys={"duration_s": 16.0})
    weights = train(env, generations, candidates)
    env.close()
    (out / "agent.py").write_text(planner_text(weights), encoding="utf-8")
    (out / "study.yaml").write_text(STUDY.format(file=(out / "agent.py").resolve()), encoding="utf-8")
    print(f"sumo-hmdp study {out / 'study.yaml'} --out {out / 'results'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(int(text) for text in sys.argv[2:]))
