"""Train one of the families with PPO of Stable-Baselines3, on one task, through Gymnasium.

    pip install -e '.[gym]' stable-baselines3
    python examples/train_with_stable_baselines3.py --env maesn/Point-v0 --task 0 --steps 20000

Stable-Baselines3 brings PyTorch and is nothing that maesn needs, which is why it is installed for
this example alone. PPO learns one task at a time from its dense reward, and starts from nothing in
every other task: what meta-learning spares. Printed are the mean return and the share of episodes
that end in the goal region, before and after training.
"""

import argparse
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3 import PPO

import maesn.gym  # noqa: F401 - registers the environments

EPISODES = 20  # of each evaluation


def main() -> None:
    """Train, and evaluate before and after."""
    options = _options()
    env = gymnasium.make(options.env, task=options.task)
    model = PPO("MlpPolicy", env, n_steps=512, seed=options.seed, device="cpu")
    _report("before training", model, env)
    model.learn(options.steps)
    _report(f"after {options.steps} steps", model, env)
    env.close()


def _report(when: str, model: PPO, env: gymnasium.Env[Any, Any]) -> None:
    played = [_play(model, env, seed) for seed in range(EPISODES)]
    returns, successes = zip(*played, strict=True)
    print(f"{when}: mean return {np.mean(returns):.1f}", end="")
    print("" if None in successes else f", {np.mean(successes):.0%} of episodes end at the goal")


def _play(model: PPO, env: gymnasium.Env[Any, Any], seed: int) -> tuple[float, bool | None]:
    """Play one episode and return its return, and whether it ends in the goal region.

    None where the family defines no success.
    """
    observation, information = env.reset(seed=seed)
    total, over = 0.0, False
    while not over:
        action, _ = model.predict(observation, deterministic=True)
        observation, reward, terminated, truncated, information = env.step(action)
        total, over = total + float(reward), terminated or truncated
    return total, information.get("is_success")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--env", default="maesn/Point-v0", help="name of the environment")
    parser.add_argument("--task", type=int, default=0, help="index of the training task")
    parser.add_argument("--steps", type=int, default=20_000, help="control steps of training")
    parser.add_argument("--seed", type=int, default=0, help="of everything that is random")
    return parser.parse_args()


if __name__ == "__main__":
    main()
