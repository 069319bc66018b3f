"""The prior over returns: an archive of latents, played in the training tasks after training."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import Key, Readings
from maesn.envs import AnyEnv, TaskSet
from maesn.learners import AbstractSettableLatent
from maesn.runtime.return_model import ReturnPrior
from maesn.settings import check_least, check_number, check_positive
from maesn.worlds import AbstractWorld
from maesn.worlds.collector import Collector

# Lower bound on a latent's noise variance, as a share of the mean over latents: the returns of a
# few episodes may agree by chance.
LEAST_NOISE = 0.05

# A batch's key is that of the number of latents before it; so many are never played.
_AGAIN = np.uint32(2**32 - 2)

Progress = Callable[[int, int], None]
"""Called with the number of latents played so far, and of all."""


@dataclasses.dataclass(frozen=True)
class PriorSettings:
    """Settings of the archive and of the episodes that the prior over returns is made of."""

    draws: int | None = None
    """Latents of the archive that are drawn from the widened prior N(0, spread^2 I). None: 400;
    250 if the tasks differ in more than their rewards, and so do not share episodes."""
    spread: float | None = None
    """Standard deviation of the widened prior; None: that of the latent, 3 for MAESN."""
    adapted: bool = True
    """Whether the archive also holds each training task's latent, after one more update with the
    dense reward."""
    episodes: int | None = None
    """Episodes of each latent, for all tasks that can share them. None: 4, or 1 if tasks do not
    share episodes and actions have no noise. With 1, a few latents tell the noise of returns."""
    action_noise: bool = False
    """Whether actions have the noise of training; see `maesn adapt --action-noise`."""
    searches: int = 20
    """Validation tasks that are searched once, so that 90 % intervals hold 90 % of the returns. 0
    keeps the model's own intervals, and so does `action_noise`."""
    seed: int = 0
    """Seed of the draws and the episodes."""
    simulations: int = 1000
    """Episodes of the archive that are played at once; bounds the memory."""

    def __post_init__(self) -> None:
        check_least(self, episodes=1, searches=0, simulations=1)
        check_number("draws", self.draws, 0 if self.adapted else 1)
        check_number("seed", self.seed, 0, 2**32 - 1)
        check_positive(self, "spread")

    def counts(self, env: AnyEnv, tasks: TaskSet) -> tuple[int, int]:
        """Return `draws` and `episodes` for these tasks, the usual ones where they are None."""
        is_cheap = len(situations(env, tasks)) <= FEW
        usual = (400, 4) if is_cheap or self.action_noise else (250, 1)
        given = self.draws, self.episodes
        draws, episodes = (u if g is None else g for u, g in zip(usual, given, strict=True))
        return draws, episodes

    def steps(self, env: AnyEnv, tasks: TaskSet) -> int:
        """Return the number of environment steps to play the archive."""
        draws, episodes = self.counts(env, tasks)
        latents, groups = draws + self.adapted * len(tasks), len(situations(env, tasks))
        repeated = min(latents, REPEATED) * min(groups, FEW) * REPEATS if episodes == 1 else 0
        return (groups * latents * episodes + repeated) * env.horizon


USUAL = PriorSettings()
# Tasks that differ in their rewards alone share episodes; they make one situation. With so many
# situations or fewer, the larger archive costs seconds.
FEW = 5
# Where each latent is played once, the noise of returns is learned from so many latents, played so
# often in the first few situations.
REPEATED, REPEATS = 20, 4


def adapted_latents(latent: AbstractSettableLatent, collect: Collector, key: Key) -> np.ndarray:
    """Return a latent of each training task, `[task, z]`, found with their dense reward."""
    keys, slots = jax.random.split(key, collect.num_tasks), jnp.arange(collect.num_tasks)
    parts = collect.parts(collect.num_tasks)
    return np.concatenate([latent.of_tasks(collect, keys[part], slots[part]) for part in parts])


def make_prior(
    latent: AbstractSettableLatent,
    world: AbstractWorld,
    latents: np.ndarray,
    settings: PriorSettings,
    progress: Progress = lambda played, of: None,
) -> ReturnPrior:
    """Play an archive, `[latent, z]`, in training tasks with the reward of the new tasks.

    Progress is called after each batch.
    """
    returns, length = play_archive(latent, world, latents, settings, progress)
    offset = world.env.horizon * np.asarray(jax.vmap(world.env.far_reward)(world.tasks.tasks))
    if np.isnan(offset).any():
        # The environment does not say. Most latents of an archive never find the goal.
        offset = np.median(returns, axis=(1, 2))
    excess = returns - length * offset[:, None, None]
    episodes = returns.shape[2]
    if episodes > 1:
        noise = excess.var(axis=2, ddof=1).mean(axis=0)
    else:
        few = situations(world.env, world.tasks)[:FEW]
        key = jax.random.fold_in(jax.random.key(settings.seed), _AGAIN)
        again, lengths = play_archive(
            latent,
            world,
            latents[:REPEATED],
            replace(settings, episodes=REPEATS),
            groups=few,
            key=key,
        )
        noises = (again - lengths * offset[:, None, None]).var(axis=2, ddof=1)
        noise = np.full(len(latents), noises[np.concatenate(few)].mean())
    return ReturnPrior(
        latents=np.asarray(latents, np.float64),
        excess=excess.mean(axis=2),
        noise=np.maximum(noise, LEAST_NOISE * noise.mean()),
        episodes=episodes,
        offset_mean=float(offset.mean()),
        offset_std=float(offset.std(ddof=1)),
    )


def play_archive(
    latent: AbstractSettableLatent,
    world: AbstractWorld,
    latents: np.ndarray,
    settings: PriorSettings,
    progress: Progress = lambda played, of: None,
    groups: Sequence[np.ndarray] | None = None,
    key: Key | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Play latents in tasks of a world. The first arguments are those of `make_prior`.

    `groups` are the tasks to play, as `situations` groups them; None: all. Returns of the others
    are 0. The key is that of the episodes; None: made of `settings.seed`.

    Returns:
        Returns, and lengths as a share of the horizon, `[task, latent, episode]` each. Tasks of the
        same situation share their episodes.
    """
    _, episodes = settings.counts(world.env, world.tasks)
    groups = situations(world.env, world.tasks) if groups is None else groups
    key = jax.random.key(settings.seed) if key is None else key
    collector = Collector(world, episodes)
    size = max(1, min(settings.simulations // episodes, collector.most_tasks, len(latents)))
    shape = (len(world.tasks), len(latents), episodes)
    returns, length, played = np.zeros(shape), np.zeros(shape), 0
    for group in groups:
        for first in range(0, len(latents), size):
            # Chunks of one size share compiled programs: the last latent fills the last of them.
            chunk = latents[np.minimum(np.arange(first, first + size), len(latents) - 1)]
            rows = np.arange(first, min(first + size, len(latents)))
            keys = jax.random.split(jax.random.fold_in(key, played), size)
            agents = replace(latent.holding(chunk), is_noisy=settings.action_noise)
            # In the first task of the group; all of its tasks judge what is played.
            batch, readings = collector.play(keys, agents, jnp.full(size, group[0]))
            action, valid = (x.reshape(-1, *x.shape[2:]) for x in (batch.action, batch.valid))
            judged = returns_under(world.env, readings, action, valid, world.tasks[group])
            shares = np.asarray(valid.mean(-1)).reshape(1, size, -1)
            parts = np.asarray(judged).reshape(len(group), size, -1), shares
            for whole, part in zip((returns, length), parts, strict=True):
                whole[np.ix_(group, rows)] = part[:, : len(rows)]
            played += len(rows)
            progress(played, len(groups) * len(latents))
    return returns, length


def situations(env: AnyEnv, tasks: TaskSet) -> list[np.ndarray]:
    """Return the indices of tasks that can share episodes, because only their rewards differ."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(jax.vmap(env.situation)(tasks.tasks))]
    groups: dict[bytes, list[int]] = {}
    for index in range(len(tasks)):
        content = b"|".join(leaf[index].tobytes() for leaf in leaves)
        groups.setdefault(content, []).append(index)
    return [np.asarray(group) for group in groups.values()]


@partial(jax.jit, static_argnums=0)
def returns_under(
    env: AnyEnv,
    readings: Readings,
    action: Float[Array, "simulation time action"],
    valid: Bool[Array, "simulation time"],
    tasks: Any,
) -> Float[Array, "task simulation"]:
    """Compute the undiscounted returns that episodes would have in other tasks of their situation.

    Args:
        env: the environment, with the reward to use.
        readings: readings of the episodes, `[time_plus_1, simulation, ...]` each.
        action: the policy's actions.
        valid: true where a step was played.
        tasks: the tasks, stacked.
    """
    before = jax.tree.map(lambda x: jnp.moveaxis(x[:-1], 0, 1), readings)
    after = jax.tree.map(lambda x: jnp.moveaxis(x[1:], 0, 1), readings)

    def in_task(task: Any) -> Array:
        def step(r: Readings, a: Array, n: Readings) -> Array:
            return env.reward(r, a, n, task).total

        return jnp.where(valid, jax.vmap(jax.vmap(step))(before, action, after), 0.0).sum(-1)

    returns: Array = jax.lax.map(in_task, tasks)
    return returns
