"""Pictures of a trained policy at work: exploration before, behaviour after adaptation."""

import math
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
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
from maesn.reporting.filmstrip import Cell, Picture, Row, contact_sheet, film
from maesn.storage import RunError, refusals, write_whole
from maesn.worlds import AbstractWorld, Scene, arena, places
from maesn.worlds.collector import Collector

_WIDTH, _HEIGHT = 300, 190  # of each episode's picture, in pixels
_MOST_SHOWN = 50  # episodes in a row: more are too small to see
_MOST_PICTURES = 50  # of a film: more make the file large and nothing clearer
# Milliseconds between two pictures: in real time, unless that is too fast or too slow to watch.
_QUICKEST, _SLOWEST = 40.0, 100.0


def render(
    run: Positional[running.AnyRun],
    evaluation: running.AnyEvaluation = USUAL,
    *,
    task: int = 0,
    after: Sequence[int] | None = None,
    shown: int = 4,
    out: running.OptionalPath = None,
    family: running.AnyFamily = None,
) -> list[Path]:
    """Film how a trained policy explores a new task, and what it does after adapting to it.

    The episodes are the first ones that `maesn adapt` plays in this task with the same evaluation,
    and are learned from: of a search, each plays another latent until it has found a good one. The
    files are an animated GIF, and a PNG of the last states.

    Args:
        run: Directory of the run, or the name of a policy, as for `maesn adapt`.
        evaluation: tasks, rule, budgets, seed.
        task: Index of the task in its set.
        after: Numbers of episodes that the agent has learned from when episodes are shown; 0 is
            before any adaptation, and the last one at most `episodes`. None: 0, and half of
            `episodes`.
        shown: Episodes that are shown each time: the first ones that are played from then on.
        out: Directory of the pictures; None: `DIR/render`.
        family: The run's family as `module:name`, if it is your own.

    Raises:
        RunError: an argument or the run cannot be used.
        RenderingError: the system has no library to draw with.
    """
    run, asked = running.open_run(run, family), evaluation
    each = asked.budget.per_update
    if after is None:
        after = (0, asked.budget.episodes // each // 2 * each)
    if not after:
        raise RunError("`after` must be at least one number of episodes.")
    with refusals():
        asked.check_reached("after", after)
    updates = [count // each for count in sorted(set(after))]
    if not 1 <= shown <= _MOST_SHOWN:
        raise RunError(f"`shown` must be from 1 to {_MOST_SHOWN}, got {shown}.")
    with running.new_tasks(run, asked) as (world, learner):
        if not 0 <= task < len(world.tasks):
            raise RunError(f"`task` must be from 0 to {len(world.tasks) - 1}, got {task}.")
        env = world.env
        stride = math.ceil(env.horizon / _MOST_PICTURES)
        if not world.film(shown, stride, (_WIDTH, _HEIGHT)):
            # Raises where pictures cannot be drawn, before minutes are spent on playing.
            Scene(env, View((-1.0, -1.0), (1.0, 1.0)), 1, 1).close()
        played = record_adaptation(learner, world, asked, task, updates, shown)
        goal = world.tasks[task]
    rows = draw(env, goal, played, stride)
    name = f"{adaptation_file(run.directory, asked).stem}-task-{task}"
    title = f"{run.settings.method} on {env.name}, {asked.reward} reward, {asked.tasks} task {task}"
    folder = run.directory / "render" if out is None else Path(out)
    period = 1000.0 * stride * env.control_period
    moving = film(title, rows, round(min(max(period, _QUICKEST), _SLOWEST)))
    written = {folder / f"{name}.gif": moving, folder / f"{name}.png": contact_sheet(title, rows)}
    for path, content in written.items():
        write_whole(path, content)
    return list(written)


class Filmed(NamedTuple):
    """An episode."""

    states: HostReadings
    """`[time, ...]` each, up to the one that ended it if that can be drawn."""
    total_return: float
    solved: bool
    """Whether it reaches the goal region at some time."""
    pictures: Sequence[Picture] = ()
    """That its environment has drawn; none if states are to be drawn."""


class Playback(NamedTuple):
    """Some episodes of one task that were played after a number of updates."""

    update: int
    mean_return: float
    """Over all episodes of the updates that were played, not only those that are kept here."""
    success_rate: float
    """Share of all these that reach the goal region at some time."""
    num_played: int
    """Their number."""
    before: int
    """Number of episodes that were learned from before."""
    episodes: list[Filmed]


def record_adaptation(
    learner: AbstractFastLearner[Any],
    world: AbstractWorld,
    evaluation: Evaluation,
    task: int,
    updates: Sequence[int],
    shown: int,
) -> list[Playback]:
    """Adapt to one task as `maesn.adapt` does, and keep the states of some of the episodes.

    After each of these numbers of `updates`, ascending, the first `shown` episodes are kept: those
    of several updates where one has fewer.
    """
    each = evaluation.budget.per_update
    wanted = {first: range(first, first + math.ceil(shown / each)) for first in updates}
    last = max(wanted[max(updates)])
    kept: dict[int, list[Filmed]] = {}

    def keep(episodes: Episodes, readings: Readings | HostReadings, stage: int) -> None:
        if any(stage in stages for stages in wanted.values()):
            # With one task at a time, its episodes are the simulations.
            filmed = [_filmed(episodes, readings, episode) for episode in range(min(each, shown))]
            drawn = zip(*world.pictures, strict=True) if world.pictures else [()] * len(filmed)
            kept[stage] = [
                one._replace(pictures=pictures) for one, pictures in zip(filmed, drawn, strict=True)
            ]

    curves = adapt(
        learner,
        Collector(world, each, keep),
        episodes=last * each,
        seed=evaluation.seed,
        tasks=[task],
    ).explored
    returns, rates = np.asarray(curves.mean_return[0]), np.asarray(curves.success_rate[0])
    playbacks = []
    for first, stages in wanted.items():
        means = float(returns[stages].mean()), float(rates[stages].mean())
        filmed = [episode for stage in stages for episode in kept[stage]][:shown]
        playbacks.append(Playback(first, *means, each * len(stages), each * first, filmed))
    return playbacks


def _filmed(episodes: Episodes, readings: Readings | HostReadings, episode: int) -> Filmed:
    """Return one episode of the only task."""
    valid, solved = (np.asarray(x[0, episode]) for x in (episodes.valid, episodes.solved))
    total_return = float(episodes.undiscounted_return[0, episode])
    return Filmed(
        _lived(readings, episode, int(valid.sum())), total_return, bool((valid & solved).any())
    )


def _lived(readings: Readings | HostReadings, episode: int, num_steps: int) -> HostReadings:
    """Return the states of one episode, without the last one if the physics blew up there."""
    states = {name: np.asarray(x)[: num_steps + 1, episode] for name, x in readings.items()}
    blown_up = not all(np.isfinite(value[num_steps]).all() for value in states.values())
    return {name: value[:num_steps] for name, value in states.items()} if blown_up else states


def draw(env: AnyEnv, task: Any, played: Sequence[Playback], stride: int) -> list[Row]:
    """Show the episodes of one task, one picture every `stride` steps, all from the same place."""
    filmed = [episode for playback in played for episode in playback.episodes]
    if any(not episode.pictures for episode in filmed):
        drawn = _draw_states(env, task, [episode.states for episode in filmed], stride)
        filmed = [
            one._replace(pictures=pictures) for one, pictures in zip(filmed, drawn, strict=True)
        ]
    rows, rest = [], iter(filmed)
    for playback in played:
        done = f"after {playback.before} episodes"
        title = (
            f"{done if playback.update else 'before adaptation'}: mean return "
            f"{playback.mean_return:.1f}, {playback.success_rate:.0%} of "
            f"{playback.num_played} episodes reach the goal"
        )
        cells = [_cell(number, next(rest)) for number in range(1, len(playback.episodes) + 1)]
        rows.append(Row(title, cells))
    return rows


def _cell(number: int, episode: Filmed) -> Cell:
    reached = ", goal reached" if episode.solved else ""
    caption = f"episode {number}: return {episode.total_return:.1f}{reached}"
    return Cell(caption, episode.solved, episode.pictures)


def _draw_states(
    env: AnyEnv, task: Any, episodes: Sequence[HostReadings], stride: int
) -> list[list[Picture]]:
    drawn = [*episodes, *(jax.tree.map(lambda x: x[-1:], states) for states in episodes)]
    seen = jax.tree.map(lambda *all_: np.concatenate([x[::stride] for x in all_]), *drawn)
    goal = jax.tree.map(lambda x: np.asarray(x)[None], task)
    times = [*range(0, env.horizon, stride), env.horizon]
    pictures: list[list[Picture]] = []
    with closing(Scene(env, arena(env, goal, seen), _WIDTH, _HEIGHT)) as scene:
        for states in episodes:
            path = places(env, states)
            pictures.append([])
            for time in times:
                now = min(time, len(path) - 1)  # an episode that has ended stands still
                present = {name: value[now] for name, value in states.items()}
                trail = np.concatenate([path[:now:stride], path[now : now + 1]])
                pictures[-1].append(scene.draw(present, task, trail))
    return pictures
