"""The exported search on Gymnasium environments, one episode at a time, beside the library's.

    python benchmarks/search_robot.py --num-tasks 30

Both search in the same tasks of `wheeled`, and the latent that each would deploy is judged on fresh
episodes. Printed are the mean returns, and the difference paired by task with its standard error.
The episodes differ: the library draws from JAX's generator, the exported policy from NumPy's.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import maesn
from maesn.gym import TaskEnv
from maesn.runtime import Explorer


@dataclass(frozen=True)
class Settings:
    """What is searched."""

    run: str = "wheeled"
    """A run, or the name of a policy that comes with the library."""
    tasks: str = "test"
    """Task set."""
    num_tasks: int = 30
    """The first so many of them."""
    episodes: int = 10
    """Of the search in each task."""
    deploy_episodes: int = 5
    """That judge the deployed latent."""
    seed: int = 0
    """Of all random draws."""


def play(explorer: Explorer, env: TaskEnv, task: int, explore: bool) -> float:
    """Play one episode and return its return."""
    observation, _ = env.reset(options={"task": task})
    explorer.begin_episode(explore=explore)
    rewards, ended = [], False
    while not ended:
        control = explorer.act(observation, normalized=True)
        observation, reward, terminated, truncated, _ = env.step(control)
        rewards.append(reward)
        ended = terminated or truncated
    explorer.end_episode(rewards)
    return float(np.sum(rewards))


def searched(policy: Path, env: TaskEnv, task: int, settings: Settings) -> float:
    """Search in one task; return the mean return of the deployed latent."""
    explorer = Explorer.load(policy, seed=settings.seed * 10_000 + task)
    env.reset(seed=settings.seed * 10_000 + task)
    for _ in range(settings.episodes):
        play(explorer, env, task, explore=True)
        explorer.adapt()
    judged = [play(explorer, env, task, explore=False) for _ in range(settings.deploy_episodes)]
    return float(np.mean(judged))


def report(name: str, values: np.ndarray) -> None:
    """Print a mean over tasks and its standard error."""
    error = values.std(ddof=1) / np.sqrt(len(values))
    print(f"{name:24s} {values.mean():9.2f} ± {error:.2f}", flush=True)


def main(settings: Settings) -> None:
    """Search with both, and compare."""
    with tempfile.TemporaryDirectory() as folder:
        policy = Path(folder) / "policy.npz"
        maesn.export(settings.run, policy, rule=maesn.SearchRule())
        family = maesn.Run.open(settings.run).settings.family
        env = TaskEnv(family, tasks=settings.tasks, reward="sparse")
        begin = time.perf_counter()
        ours = [searched(policy, env, task, settings) for task in range(settings.num_tasks)]
        env.close()
        print(f"exported: {time.perf_counter() - begin:.0f} s")
        done = maesn.adapt(
            settings.run,
            rule=maesn.SearchRule(),
            tasks=settings.tasks,
            num_tasks=settings.num_tasks,
            episodes=settings.episodes,
            deploy_episodes=settings.deploy_episodes,
            deploy_after=(settings.episodes,),
            seed=settings.seed,
            out=Path(folder) / "table.csv",
        )
    theirs = np.asarray(done.curves.mean_return[:, -1], np.float64)
    report("exported, maesn.gym", np.asarray(ours))
    report("library", theirs)
    report("difference", np.asarray(ours) - theirs)


if __name__ == "__main__":
    main(tyro.cli(Settings))
