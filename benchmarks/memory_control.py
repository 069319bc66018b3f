"""Does a policy with memory use what it remembers? Second episodes with memories exchanged.

    python benchmarks/memory_control.py results/jobs/train-wheeled-rl2-seed-0-6021905c39ef085c/run

The run's policy plays first episodes of trials, and then one and the same second episode (starts
and noise) several times: with what its own trial has left, with what the trial of another task
has left, with the mean of all of them, and with nothing. Its own memory against nothing says what
remembering is worth, and against another task's whether it is the task that is remembered: that one
misleads who trusts it. Where all memories are worth the same, but not what nothing is, they say
only that there was an episode before.
"""

import math
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from maesn.envs import RewardKind
from maesn.experience.agent import TrialState
from maesn.runs.run import Run
from maesn.worlds.collector import Collector


@dataclass(frozen=True)
class Settings:
    """What is played."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run directory of a policy with memory; its last checkpoint plays."""
    tasks: str = "training"
    """Task set."""
    reward_kind: RewardKind | None = None
    """Dense or sparse; None for that of training."""
    episodes_per_task: int = 20
    """Trials per task."""
    seed: int = 0
    """Of episodes."""


def exchanged(own: TrialState) -> dict[str, TrialState]:
    """Return what the second episodes may begin with, by name; all are `[task, episode, ...]`."""
    half = own.reward.shape[0] // 2
    # Half of all tasks apart: neighbours may be alike.
    return {
        "nothing": jax.tree.map(jnp.zeros_like, own),
        "its own memory": own,
        "another task's": jax.tree.map(lambda x: jnp.roll(x, half, axis=0), own),
        "the mean of all": jax.tree.map(lambda x: jnp.broadcast_to(x.mean((0, 1)), x.shape), own),
    }


def played(settings: Settings) -> Iterator[tuple[str, np.ndarray]]:
    """Yield what the second episode begins with, and the mean return of every task.

    Raises:
        ValueError: no episode is remembered, or there is no other task to exchange memories with.
    """
    run = Run.open(settings.run)
    tasks = run.task_set(settings.tasks)
    if len(tasks) < 2:
        raise ValueError(f"`tasks` must hold at least 2 tasks, got {len(tasks)}.")
    learner = run.learner.fast_learner(run.latest_state())
    first, second = jax.random.split(jax.random.key(settings.seed), (2, len(tasks)))
    state, index = learner.init(first), jnp.arange(len(tasks))
    with closing(run.world(tasks, settings.reward_kind)) as world:
        collect = Collector(world, settings.episodes_per_task)
        state = learner.update(state, collect(first, learner.agents(state), index))
        agents = learner.agents(state)
        own = agents.trial_state
        if own is None:
            raise ValueError(
                "`run` must be of a method that remembers earlier episodes, got "
                f"{run.settings.method}."
            )
        print(describe(own))
        for name, memory in exchanged(own).items():
            episodes = collect(second, replace(agents, trial_state=memory), index)
            yield name, np.asarray(episodes.undiscounted_return.mean(1))


def describe(memory: TrialState) -> str:
    """Return a line on the policy's own memory after the first episode."""
    leaves = jax.tree.leaves(memory.recurrent_state)
    units = np.concatenate(
        [np.asarray(x).reshape(-1, x.shape[-1]) for x in leaves],
        axis=-1,
    )
    return (
        f"after the first episode: mean size of a unit {np.abs(units).mean():.3f}, its standard "
        f"deviation over {len(units)} trials {units.std(0).mean():.3f}"
    )


def main(settings: Settings) -> None:
    """Print the returns of second episodes, by what they begin with."""
    for name, returns in played(settings):
        error = returns.std(ddof=1) / math.sqrt(len(returns))
        print(
            f"second episode with {name:15s} {returns.mean():8.1f} ± {error:.1f} (one standard "
            f"error over {len(returns)} tasks)",
            flush=True,
        )


if __name__ == "__main__":
    main(tyro.cli(Settings))
