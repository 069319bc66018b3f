"""Pictures of a trained policy at work: exploration before, behaviour after adaptation."""

import math
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from tyro.conf import Positional

from maesn.axes import HostReadings, Readings
from maesn.envs import AnyEnv
from maesn.evaluation import running
from maesn.evaluation.evaluate import adapt
from maesn.evaluation.evaluation import USUAL, Evaluation
from maesn.evaluation.tables import adaptation_file
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner
from maesn.physics import View
from maesn.report.filmstrip import Cell, Row, contact_sheet, film
from maesn.storage import RunError, write_whole
from maesn.worlds import AbstractWorld, Scene, arena, places
from maesn.worlds.collector import Collector

_WIDTH, _HEIGHT = 300, 190  # of each episode's picture, in pixels
_MOST_PICTURES = 50  # of a film: more make the file large and nothing clearer
# Milliseconds between two pictures: in real time, unless that is too fast or too slow to watch.
_QUICKEST, _SLOWEST = 40.0, 100.0


def render(
    run: Positional[running.AnyRun],
    evaluation: running.AnyEvaluation = USUAL,
    *,
    task: int = 0,
    after: Sequence[int] = (0, 250),
    shown: int = 4,
    out: running.OptionalPath = None,
    family: running.AnyFamily = None,
) -> list[Path]:
    """Film how a trained policy explores a new task, and what it does after adapting to it.

    The episodes are the first ones that `maesn adapt` plays in this task with the same evaluation.

    Args:
        run: Directory of the run, whose last checkpoint is adapted, or the name of a policy that
            comes with the library (`maesn list`). A directory of that name in the current folder
            wins; without one, files go to `maesn-NAME` there, a run directory like any other.
        evaluation: tasks, rule, budgets, seed.
        task: Index of the task in its set.
        after: Numbers of episodes that the agent has learned from when episodes are shown; 0 is
            before any adaptation, and the last one at most `episodes`.
        shown: Episodes that are shown each time: the first ones that are played.
        out: Directory of the pictures; None: `DIR/render`.
        family: The run's family as `module:name`, if it is your own.

    Returns:
        The files that were written: an animated GIF, and a PNG of the last states.

    Raises:
        RunError: an argument or the run cannot be used.
        RenderingError: the system has no library to draw with.
    """
    run, asked = running.open_run(run, family), evaluation
    updates = _updates(sorted(set(after)), asked)
    each = asked.budget.per_update
    if not 1 <= shown <= each:
        raise RunError(f"`shown` must be from 1 to `episodes_per_update`, {each}, got {shown}.")
    with running.new_tasks(run, asked) as (world, learner):
        if not 0 <= task < len(world.tasks):
            raise RunError(f"`task` must be from 0 to {len(world.tasks) - 1}, got {task}.")
        env = world.env
        # Raises where pictures cannot be drawn, before minutes are spent on playing.
        Scene(env, View((-1.0, -1.0), (1.0, 1.0)), 1, 1).close()
        played = record_adaptation(learner, world, asked, task, updates, shown)
        goal = world.tasks[task]
    stride = math.ceil(env.horizon / _MOST_PICTURES)
    with closing(_Stage(env, goal, played, stride)) as stage:
        rows = [stage.row(playback, each) for playback in played]
    name = f"{adaptation_file(run.directory, asked).stem}-task-{task}"
    title = f"{run.settings.method} on {env.name}, {asked.reward} reward, {asked.tasks} task {task}"
    folder = run.directory / "render" if out is None else Path(out)
    period = 1000.0 * stride * env.control_period
    moving = film(title, rows, round(min(max(period, _QUICKEST), _SLOWEST)))
    still = contact_sheet(title, rows)
    written = {folder / f"{name}.gif": moving, folder / f"{name}.png": still}
    for path, content in written.items():
        write_whole(path, content)
    return list(written)


def _updates(after: Sequence[int], evaluation: Evaluation) -> list[int]:
    """Return the numbers of updates that lie behind numbers of episodes, ascending."""
    each, most = evaluation.budget.per_update, evaluation.budget.episodes
    if not after or after[0] < 0 or after[-1] > most or any(count % each for count in after):
        raise RunError(
            "`after` must be numbers of episodes, multiples of `episodes_per_update`, "
            f"{each}, from 0 to `episodes`, {most}, got {list(after)}."
        )
    return [count // each for count in after]


class Playback(NamedTuple):
    """Some episodes of one task that were played after a number of updates."""

    update: int
    mean_return: float
    """Over all episodes that were played, not only those that are kept here."""
    success_rate: float
    """Share of all episodes that reach the goal region at some time."""
    readings: HostReadings
    """States of the episodes that are kept, `[time_plus_1, episode, ...]` each."""
    num_steps: Int[np.ndarray, " episode"]
    """Steps until an episode ended; the states behind are garbage."""
    returns: Float[np.ndarray, " episode"]
    solved: Bool[np.ndarray, " episode"]
    """Whether the episode reaches the goal region at some time."""


def record_adaptation(
    learner: AbstractFastLearner[Any],
    world: AbstractWorld,
    evaluation: Evaluation,
    task: int,
    updates: Sequence[int],
    shown: int,
) -> list[Playback]:
    """Adapt to one task as `maesn.adapt` does, and keep the states of some of the episodes.

    After each of these numbers of `updates`, ascending, the first `shown` episodes are kept.
    """
    kept: list[tuple[Any, ...]] = []

    def keep(episodes: Episodes, readings: Readings | HostReadings, stage: int) -> None:
        # With one task at a time, its episodes are the simulations.
        if stage in updates:
            states = jax.tree.map(lambda x: np.asarray(x[:, :shown]), readings)
            kept.append((states, *_of_each(episodes, shown)))

    each = evaluation.budget.per_update
    curves = adapt(
        learner,
        Collector(world, each, keep),
        episodes=max(updates) * each,
        seed=evaluation.seed,
        tasks=[task],
    ).explored
    returns, rates = curves.mean_return[0], curves.success_rate[0]
    return [
        Playback(update, float(returns[update]), float(rates[update]), *what)
        for update, what in zip(updates, kept, strict=True)
    ]


def _of_each(episodes: Episodes, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return number of steps, return and success of the first episodes of the only task."""
    valid, solved = np.asarray(episodes.valid[0]), np.asarray(episodes.solved[0])
    returns = np.asarray(episodes.undiscounted_return[0])
    return valid.sum(-1)[:count], returns[:count], (valid & solved).any(-1)[:count]


class _Stage:
    """Draws the episodes of one task, all from the same place."""

    def __init__(self, env: AnyEnv, task: Any, played: Sequence[Playback], stride: int) -> None:
        self._env = env
        self._task = task
        self._stride = stride
        lived = [self._lived(one, episode) for one in played for episode in _episodes(one)]
        drawn = [*lived, *(jax.tree.map(lambda x: x[-1:], states) for states in lived)]
        seen = jax.tree.map(lambda *all_: np.concatenate([x[::stride] for x in all_]), *drawn)
        goal = jax.tree.map(lambda x: np.asarray(x)[None], task)
        self._scene = Scene(env, arena(env, goal, seen), _WIDTH, _HEIGHT)

    def row(self, playback: Playback, num_played: int) -> Row:
        """Draw all episodes of one number of updates."""
        cells = [self._cell(playback, episode) for episode in _episodes(playback)]
        done = f"after {playback.update * num_played} episodes"
        return Row(
            f"{done if playback.update else 'before adaptation'}: mean return "
            f"{playback.mean_return:.1f}, {playback.success_rate:.0%} of {num_played} episodes "
            "reach the goal",
            cells,
        )

    def close(self) -> None:
        """Give the memory of the drawing library back."""
        self._scene.close()

    def _cell(self, playback: Playback, episode: int) -> Cell:
        states = self._lived(playback, episode)
        path = places(self._env, states)
        times = [*range(0, self._env.horizon, self._stride), self._env.horizon]

        def picture(time: int) -> np.ndarray:
            now = {name: value[time] for name, value in states.items()}
            trail = np.concatenate([path[: time : self._stride], path[time : time + 1]])
            return self._scene.draw(now, self._task, trail)

        # An episode that has ended stands still.
        pictures = [picture(min(time, len(path) - 1)) for time in times]
        reached = bool(playback.solved[episode])
        caption = f"episode {episode + 1}: return {playback.returns[episode]:.1f}"
        return Cell(f"{caption}, goal reached" if reached else caption, reached, pictures)

    def _lived(self, playback: Playback, episode: int) -> HostReadings:
        """Return the states of one episode, up to the one that ended it if that can be drawn."""
        last = int(playback.num_steps[episode])
        states = {name: value[: last + 1, episode] for name, value in playback.readings.items()}
        blown_up = not all(np.isfinite(value[last]).all() for value in states.values())
        return {name: value[:last] for name, value in states.items()} if blown_up else states


def _episodes(playback: Playback) -> range:
    return range(len(playback.num_steps))
