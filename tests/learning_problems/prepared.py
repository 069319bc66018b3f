"""Random experience for the reference, and the same experience for the library, padded."""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array as JaxArray
from reference.advantage import AdvantageSettings, Episode, experience
from reference.maesn import Agent, Settings, TaskData, adapted, inner_update, start
from reference.parameters import Array, Parameters, random_parameters
from reference.policy import action_log_std, action_mean

from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.numerics import DiagonalGaussian

HORIZON = 6
OBSERVATION, ACTION, LATENT, ROWS = 3, 2, 2, 5
SIZES = (OBSERVATION, 5, ACTION)
EQUAL = (HORIZON,) * 4
UNEQUAL = (HORIZON, 3, 1, 5)


def play(
    rng: np.random.Generator,
    theta: Parameters,
    mean: Array,
    log_std: Array,
    lengths: tuple[int, ...],
) -> list[Episode]:
    """Play one task by an agent, in a world of random observations.

    Some observations exceed the range that the baseline clips to. Rewards depend on the actions
    and are skewed, so that no advantage vanishes and no sign can hide.
    """
    episodes = []
    for steps in lengths:
        observation = rng.normal(size=(steps, OBSERVATION)) * np.array([1.0, 0.5, 1.0])
        noise = rng.normal(size=mean.shape)
        latent = mean + np.exp(log_std) * noise
        action_means = action_mean(theta, observation, latent)
        log_stds = np.tile(action_log_std(theta), (steps, 1))
        action = action_means + np.exp(log_stds) * rng.normal(size=action_means.shape)
        reward = -np.sum((action - 0.5) ** 2, axis=1) + np.exp(0.3 * rng.normal(size=steps))
        episodes.append(Episode(observation, action, reward, noise, latent, action_means, log_stds))
    return episodes


@dataclass(frozen=True)
class Problem:
    """A meta-batch of every row: parameters, and what was played with them."""

    parameters: Parameters
    tasks: list[TaskData]
    """One per row of the table of latents."""
    settings: Settings
    advantage: AdvantageSettings

    def batches(self, phase: int) -> list[list[Episode]]:
        """Return every row's episodes of one collection."""
        return [[*task.pre, task.post][phase].episodes for task in self.tasks]

    def playing(self, phase: int) -> list[Agent]:
        """Return who plays them."""
        return [
            adapted(self.parameters, replace(task, pre=task.pre[:phase]), self.settings)
            for task in self.tasks
        ]


def lengths_of(row: int, lengths: tuple[int, ...]) -> tuple[int, ...]:
    """Return the lengths of one task's episodes; if they differ, they differ between tasks too."""
    return tuple(n if n == HORIZON else 1 + (n + row) % HORIZON for n in lengths)


def make_problem(
    seed: int,
    lengths: tuple[int, ...],
    settings: Settings | None = None,
    inner_updates: int = 1,
    advantage: AdvantageSettings | None = None,
    latent: int = LATENT,
) -> Problem:
    """Play and adapt in every row, all by the reference."""
    settings, advantage = settings or Settings(), advantage or AdvantageSettings()
    rng = np.random.default_rng(seed)
    parameters = random_parameters(rng, SIZES, latent, ROWS)
    tasks = []
    for row in range(ROWS):
        agent, pre, steps = start(parameters, row), [], lengths_of(row, lengths)
        for _ in range(inner_updates):
            episodes = play(rng, agent.theta, agent.mean, agent.log_std, steps)
            pre.append(experience(episodes, advantage))
            agent = inner_update(
                agent, parameters["mean_step"], parameters["log_std_step"], pre[-1], settings
            )
        post = play(rng, agent.theta, agent.mean, agent.log_std, steps)
        tasks.append(TaskData(row, pre, experience(post, advantage)))
    return Problem(parameters, tasks, settings, advantage)


def pad(episodes: list[Episode], garbage: float = 0.0) -> Episodes:
    """Give one task's episodes the library's fixed length.

    Args:
        episodes: of one task.
        garbage: what every array of floats holds after the end of an episode.
    """

    def padded(arrays: list[Array], steps: int = HORIZON) -> JaxArray:
        rows = [
            np.concatenate([x, np.full((steps - len(x), *x.shape[1:]), garbage)]) for x in arrays
        ]
        return jnp.asarray(np.stack(rows), dtype=float)

    lengths = np.array([len(e.reward) for e in episodes])
    valid = jnp.asarray(np.arange(HORIZON) < lengths[:, None])
    return Episodes(
        observation=padded([e.observation for e in episodes], HORIZON + 1),
        action=padded([e.action for e in episodes]),
        reward=padded([e.reward for e in episodes]),
        goal_reward=padded([e.reward for e in episodes]),
        valid=valid,
        # Garbage as well: nothing is solved in the valid steps.
        solved=jnp.asarray(np.asarray(valid) & False if garbage == 0 else ~np.asarray(valid)),
        solved_at_start=jnp.asarray(np.zeros(len(lengths), bool)),
        terminated=jnp.asarray(lengths < HORIZON),
        noise=jnp.asarray(np.stack([e.noise for e in episodes]), dtype=float),
        description=jnp.asarray(np.zeros((len(episodes), 0)), float),
        z=jnp.asarray(np.stack([e.latent for e in episodes]), dtype=float),
        behaviour=DiagonalGaussian(
            padded([e.mean for e in episodes]), padded([e.log_std for e in episodes])
        ),
        trial_end=None,
    )


def stack(batch: list[list[Episode]], garbage: float = 0.0) -> Episodes:
    """Give a batch of tasks the library's form, `[task, episode, ...]`."""
    tasks = [pad(episodes, garbage) for episodes in batch]
    # By NumPy, which compiles nothing.
    return jax.tree.map(lambda *arrays: jnp.asarray(np.stack(arrays)), *tasks)


@dataclass
class PreparedCollect:
    """A `Collect` that hands out prepared episodes and remembers who asked for them."""

    problem: Problem
    garbage: float = 0.0
    num_tasks: int = ROWS
    asked: list[Agents] = field(default_factory=list)
    index: list[Array] = field(default_factory=list)

    @property
    def episodes_per_task(self) -> int:
        return len(self.problem.batches(0)[0])

    def __call__(
        self, keys: JaxArray, agents: Agents, task_index: JaxArray, stage: int = 0
    ) -> Episodes:
        """Return the next batch of the tasks that are asked for."""
        batch = self.problem.batches(len(self.asked))
        self.asked.append(agents)
        self.index.append(np.asarray(task_index))
        return stack([batch[row] for row in self.index[-1]], self.garbage)

    def chosen(self) -> list[TaskData]:
        """Return the reference's data of the tasks that were asked for."""
        return [self.problem.tasks[row] for row in self.index[0]]
