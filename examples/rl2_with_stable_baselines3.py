"""RL2 on one of the families, with the recurrent PPO of sb3-contrib, through Gymnasium.

    pip install -e '.[gym]' sb3-contrib
    python examples/rl2_with_stable_baselines3.py --env maesn/SparsePoint-v0 --steps 100000

RL2 learns to explore with a recurrent policy: it plays some episodes of a task as one long one, a
trial, and sees its last action, the last reward, and whether an episode has just begun. `Trials`
makes such an environment of any of the library's. Its training tasks are those that the library's
own methods train on, and its test tasks those that they report. Printed is the mean return of each
episode of a trial in 20 of the test tasks, before and after training.

sb3-contrib brings PyTorch and is nothing that maesn needs, so that it is installed for this example
alone.
"""

import argparse
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, flatdim, flatten

import maesn.gym  # noqa: F401 - registers the environments

TEST_TASKS = 20  # the first ones of the set


class Trials(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Several episodes of one task as one long episode.

    The observation is that of the environment, then the last action, the last reward, and 1 in the
    first step of each episode, else 0. `info["returns"]` has the returns of the trial's episodes.

    Args:
        env: an environment whose `reset` takes the option `task`.
        episodes: number of episodes in a trial.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], episodes: int = 3) -> None:
        super().__init__(env)
        self.episodes = episodes
        size = flatdim(env.observation_space) + flatdim(env.action_space) + 2
        self.observation_space = Box(-np.inf, np.inf, (size,), np.float32)
        self.returns: list[float] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start a trial, in a task that is drawn or chosen."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.task, self.returns = info["task"], [0.0]
        nothing = np.zeros(flatdim(self.env.action_space))
        return self._seen(observation, nothing, 0.0, begins=True), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by one step; the last one of an episode leads to the start of the next."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.returns[-1] += float(reward)
        info["returns"] = list(self.returns)
        over = terminated or truncated
        ends = over and len(self.returns) == self.episodes
        if over and not ends:
            observation, _ = self.env.reset(options={"task": self.task})
            self.returns.append(0.0)
        taken = flatten(self.env.action_space, action)
        seen = self._seen(observation, taken, float(reward), begins=over and not ends)
        return seen, float(reward), False, ends, info

    def _seen(self, observation: Any, action: Any, reward: float, *, begins: bool) -> np.ndarray:
        return np.concatenate([observation, action, [reward, begins]]).astype(np.float32)


def report(when: str, model: Any, env: Trials) -> None:
    """Play a trial in each of some test tasks, and print the mean returns of its episodes."""
    returns = []
    for task in range(min(TEST_TASKS, len(env.unwrapped.tasks))):  # type: ignore[attr-defined]
        observation, info = env.reset(seed=task, options={"task": task})
        state, begins, over = None, np.ones(1, bool), False
        while not over:
            action, state = model.predict(observation, state=state, episode_start=begins)
            observation, _, _, over, info = env.step(action)
            begins = np.zeros(1, bool)
        returns.append(info["returns"])
    print(f"{when}:", " ".join(f"{mean:.2f}" for mean in np.mean(returns, axis=0)))


def main() -> None:
    """Train, and play in test tasks before and after."""
    from sb3_contrib import RecurrentPPO  # noqa: PLC0415 - `Trials` alone needs no PyTorch

    options = _options()
    train, test = (
        Trials(gymnasium.make(options.env, tasks=tasks, reward=options.reward), options.episodes)
        for tasks in ("training", "test")
    )
    model = RecurrentPPO("MlpLstmPolicy", train, n_steps=512, seed=options.seed, device="cpu")
    report("before training", model, test)
    model.learn(options.steps)
    report(f"after {options.steps} steps", model, test)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--env", default="maesn/SparsePoint-v0", help="name of the environment")
    parser.add_argument("--reward", default="sparse", help="dense or sparse")
    parser.add_argument("--episodes", type=int, default=3, help="episodes of a trial")
    parser.add_argument("--steps", type=int, default=100_000, help="control steps of training")
    parser.add_argument("--seed", type=int, default=0, help="of everything that is random")
    return parser.parse_args()


if __name__ == "__main__":
    main()
