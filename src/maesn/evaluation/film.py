"""Pictures of a trained policy at work: exploration before, behaviour after adaptation."""

import math
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import jax
import numpy as np

from maesn.axes import HostReadings
from maesn.envs import AnyEnv, RewardKind, TaskFamily
from maesn.evaluation.playback import Playback, record_adaptation
from maesn.evaluation.tables import adaptation_file
from maesn.physics import View
from maesn.report.filmstrip import Cell, Row, contact_sheet, film
from maesn.runs.run import Run
from maesn.runs.shipped import working_copy
from maesn.storage import RunError, explained, write_whole
from maesn.worlds import Scene, arena, places
from maesn.worlds.collector import Collector

_WIDTH, _HEIGHT = 300, 190  # of each episode's picture, in pixels
_MOST_PICTURES = 50  # of a film: more make the file large and nothing clearer
# Milliseconds between two pictures: in real time, unless that is too fast or too slow to watch.
_QUICKEST, _SLOWEST = 40.0, 100.0


def render(
    directory: str | Path,
    *,
    task: int = 0,
    update: Sequence[int] = (0, 5),
    reward: RewardKind = "sparse",
    tasks: str = "test",
    episodes: int = 4,
    episodes_per_task: int = 50,
    seed: int = 0,
    out: str | Path | None = None,
    family: str | TaskFamily | None = None,
) -> list[Path]:
    """Film how a trained policy explores a new task, and what it does after adapting to it.

    The episodes are the first ones of those that `adapt` plays in this task with the same seed.

    Args:
        directory: of the run, or the name of a policy that comes with the library; its latest
            checkpoint is adapted.
        task: index of the task in its set.
        update: numbers of updates after which episodes are shown; 0 is before any adaptation.
        reward: dense or sparse.
        tasks: test, validation, training, ood, or the path of an `.npz` file.
        episodes: how many episodes are shown after each of these updates.
        episodes_per_task: how many are played; an update learns from all of them.
        seed: of the episodes.
        out: directory of the pictures; None for `render` in the run's directory.
        family: the run's family, if it is your own: itself, or `module:name`.

    Returns:
        The files that were written: an animated GIF, and a PNG of the last states.

    Raises:
        RunError: an argument or the run cannot be used.
        RenderingError: the system has no library to draw with.
    """
    run = Run.open(working_copy(directory), family=family)
    task_set, updates = run.task_set(tasks), sorted(set(update))
    _check(task, len(task_set), updates, episodes, episodes_per_task, seed)
    env = run.env(reward)
    _refuse_blindness(env)
    learner = run.learner.fast_learner(run.latest_state())
    with closing(run.world(task_set, reward)) as world:
        collect = Collector(world, episodes_per_task)
        played = record_adaptation(
            learner, collect, task=task, updates=updates, num_episodes=episodes, seed=seed
        )
    stride = math.ceil(env.horizon / _MOST_PICTURES)
    with closing(_Stage(env, task_set[task], played, stride)) as stage:
        rows = [stage.row(playback, episodes_per_task) for playback in played]
    name = f"{adaptation_file(run.directory, tasks, reward).stem}-task-{task}"
    title = f"{run.settings.method} on {run.config.family}, {reward} reward, {tasks} task {task}"
    folder = run.directory / "render" if out is None else Path(out)
    period = 1000.0 * stride * env.control_period
    moving = film(title, rows, round(min(max(period, _QUICKEST), _SLOWEST)))
    return _write(folder, {f"{name}.gif": moving, f"{name}.png": contact_sheet(title, rows)})


def _check(
    task: int, num_tasks: int, updates: list[int], episodes: int, played: int, seed: int
) -> None:
    if not 0 <= task < num_tasks:
        raise RunError(f"`task` must be from 0 to {num_tasks - 1}, got {task}.")
    if not updates or updates[0] < 0:
        raise RunError(f"`update` must be at least one number from 0 on, got {updates}.")
    if not 1 <= episodes <= played:
        raise RunError(
            f"`episodes` must be from 1 to `episodes_per_task`, {played}, got {episodes}."
        )
    if not 0 <= seed < 2**32:
        raise RunError(f"`seed` must be from 0 to 2^32 - 1, got {seed}.")


def _refuse_blindness(env: AnyEnv) -> None:
    """Find out whether pictures can be drawn here before minutes are spent on playing."""
    Scene(env, View((-1.0, -1.0), (1.0, 1.0)), 1, 1).close()


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
        done = f"after {playback.update} update{'s' if playback.update > 1 else ''}"
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
        # An episode that has ended stands still.
        pictures = [self._picture(states, path, min(time, len(path) - 1)) for time in times]
        reached = bool(playback.solved[episode])
        caption = f"episode {episode + 1}: return {playback.returns[episode]:.1f}"
        return Cell(f"{caption}, goal reached" if reached else caption, reached, pictures)

    def _picture(self, states: HostReadings, path: np.ndarray, time: int) -> np.ndarray:
        now = {name: value[time] for name, value in states.items()}
        trail = np.concatenate([path[: time : self._stride], path[time : time + 1]])
        return self._scene.draw(now, self._task, trail)

    def _lived(self, playback: Playback, episode: int) -> HostReadings:
        """Return the states of one episode, up to the one that ended it if that can be drawn."""
        last = int(playback.num_steps[episode])
        states = {name: value[: last + 1, episode] for name, value in playback.readings.items()}
        blown_up = not all(np.isfinite(value[last]).all() for value in states.values())
        return {name: value[:last] for name, value in states.items()} if blown_up else states


def _episodes(playback: Playback) -> range:
    return range(len(playback.num_steps))


def _write(folder: Path, files: dict[str, bytes]) -> list[Path]:
    with explained("make", folder):
        folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        write_whole(folder / name, content)
    return [folder / name for name in files]
