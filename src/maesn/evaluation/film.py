"""Pictures of a trained policy at work: exploration before, behaviour after adaptation."""

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np
from tyro.conf import Positional

from maesn.axes import HostReadings, Readings
from maesn.envs import AnyEnv
from maesn.evaluation.arguments import AnyFamily, AnyRun, OptionalPath
from maesn.evaluation.evaluate import adapt
from maesn.evaluation.evaluation import USUAL, AnyEvaluation, Evaluation
from maesn.evaluation.running import adaptation_file, new_tasks, open_run
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
    run: Positional[AnyRun],
    evaluation: AnyEvaluation = USUAL,
    *,
    task: int = 0,
    after: Sequence[int] | None = None,
    shown: int = 4,
    out: OptionalPath = None,
    family: AnyFamily = None,
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
    run, asked = open_run(run, family), evaluation
    each = asked.budget.per_update
    if after is None:
        after = (0, asked.budget.episodes // each // 2 * each)
    if not after:
        raise RunError("`after` must be at least one number of episodes.")
    with refusals():
        asked.check_reached("after", after)
    if not 1 <= shown <= _MOST_SHOWN:
        raise RunError(f"`shown` must be from 1 to {_MOST_SHOWN}, got {shown}.")
    with new_tasks(run, asked) as (world, learner):
        if not 0 <= task < len(world.tasks):
            raise RunError(f"`task` must be from 0 to {len(world.tasks) - 1}, got {task}.")
        env = world.env
        stride = math.ceil(env.horizon / _MOST_PICTURES)
        if not world.film(shown, stride, (_WIDTH, _HEIGHT)):
            # Raises where pictures cannot be drawn, before minutes are spent on playing.
            Scene(env, View((-1.0, -1.0), (1.0, 1.0)), 1, 1).close()
        played = record_adaptation(learner, world, asked, task, sorted(set(after)), shown)
        goal = world.tasks[task]
    rows = draw(env, goal, played, stride, shown)
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


Played: TypeAlias = Mapping[int, Sequence[Filmed]]
"""Number of episodes that were learned from before -> the episodes that were played next."""


def record_adaptation(
    learner: AbstractFastLearner[Any],
    world: AbstractWorld,
    evaluation: Evaluation,
    task: int,
    after: Sequence[int],
    shown: int,
) -> Played:
    """Adapt to one task as `maesn.adapt` does, and keep some of the episodes.

    After each of these numbers, all episodes of the next update are kept, or of the next updates
    until there are `shown`.
    """
    each = evaluation.budget.per_update
    played: dict[int, list[Filmed]] = {before: [] for before in after}

    def keep(episodes: Episodes, readings: Readings | HostReadings, update: int) -> None:
        for before in after:
            if 0 <= update * each - before < shown:
                played[before] += _filmed(episodes, readings, world.pictures)

    episodes = (max(after) + shown - 1) // each * each
    collect = Collector(world, each, keep)
    adapt(learner, collect, Evaluation(seed=evaluation.seed), episodes=episodes, tasks=[task])
    return played


def _filmed(
    episodes: Episodes,
    readings: Readings | HostReadings,
    pictures: Sequence[Sequence[Picture]],
) -> list[Filmed]:
    """Return the episodes of the only task, which are the simulations."""
    lengths = np.asarray(episodes.valid[0].sum(-1))
    solved = np.asarray((episodes.valid & episodes.solved)[0].any(-1))
    drawn = dict(enumerate(zip(*pictures, strict=True)))  # the first ones alone, if any
    return [
        Filmed(
            _lived(readings, number, int(lengths[number])),
            float(total_return),
            bool(solved[number]),
            drawn.get(number, ()),
        )
        for number, total_return in enumerate(episodes.undiscounted_return[0])
    ]


def _lived(readings: Readings | HostReadings, episode: int, num_steps: int) -> HostReadings:
    """Return the states of one episode, without the last one if the physics blew up there."""
    states = {name: np.asarray(x)[: num_steps + 1, episode] for name, x in readings.items()}
    blown_up = not all(np.isfinite(value[num_steps]).all() for value in states.values())
    return {name: value[:num_steps] for name, value in states.items()} if blown_up else states


def draw(env: AnyEnv, task: Any, played: Played, stride: int, shown: int) -> list[Row]:
    """Show the first episodes of each time, one picture every `stride` steps, from one place."""
    filmed = [episode for episodes in played.values() for episode in episodes[:shown]]
    pictures = iter([episode.pictures for episode in filmed])
    if not all(episode.pictures for episode in filmed):
        pictures = iter(_draw_states(env, task, [episode.states for episode in filmed], stride))
    rows = []
    for before, episodes in played.items():
        mean_return = np.mean([episode.total_return for episode in episodes])
        success_rate = np.mean([episode.solved for episode in episodes])
        when = f"after {before} episodes" if before else "before adaptation"
        title = (
            f"{when}: mean return {mean_return:.1f}, {success_rate:.0%} of {len(episodes)} "
            "episodes reach the goal"
        )
        cells = []
        for number, episode in enumerate(episodes[:shown], start=1):
            reached = ", goal reached" if episode.solved else ""
            caption = f"episode {number}: return {episode.total_return:.1f}{reached}"
            cells.append(Cell(caption, episode.solved, next(pictures)))
        rows.append(Row(title, cells))
    return rows


def _draw_states(
    env: AnyEnv, task: Any, episodes: Sequence[HostReadings], stride: int
) -> list[Sequence[Picture]]:
    drawn = [*episodes, *(jax.tree.map(lambda x: x[-1:], states) for states in episodes)]
    seen = jax.tree.map(lambda *all_: np.concatenate([x[::stride] for x in all_]), *drawn)
    goal = jax.tree.map(lambda x: np.asarray(x)[None], task)
    times = [*range(0, env.horizon, stride), env.horizon]
    with closing(Scene(env, arena(env, goal, seen), _WIDTH, _HEIGHT)) as scene:

        def picture(states: HostReadings, path: np.ndarray, time: int) -> Picture:
            now = min(time, len(path) - 1)  # an episode that has ended stands still
            trail = np.concatenate([path[:now:stride], path[now : now + 1]])
            return scene.draw({name: x[now] for name, x in states.items()}, task, trail)

        paths = [places(env, states) for states in episodes]
        return [
            [picture(states, path, time) for time in times]
            for states, path in zip(episodes, paths, strict=True)
        ]
