"""Pictures of a trained policy at work: exploration before, behaviour after adaptation."""

import io
import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image
from tyro.conf import Positional

from maesn.axes import HostReadings, Readings
from maesn.envs import AnyEnv
from maesn.evaluation.adapting import adapt
from maesn.evaluation.arguments import AnyFamily, AnyMethod, AnyRun, OptionalPath
from maesn.evaluation.evaluation import USUAL, AnyEvaluation, Evaluation
from maesn.evaluation.running import adaptation_file, new_tasks, open_run
from maesn.experience.episodes import Episodes
from maesn.learners import AbstractFastLearner
from maesn.physics import View
from maesn.reporting import style
from maesn.reporting.reading import count_of
from maesn.settings import check_number
from maesn.storage import refusals, write_whole
from maesn.worlds import AbstractWorld, Scene, arena, places
from maesn.worlds.collector import Collector

_SIZE = 330, 248  # of each episode's picture, in pixels
_PANEL = 3.4, 3.1  # of a picture with its texts, in inches
_TEXT = 11  # points: two columns stay legible on a phone
_MOST_SHOWN = 50  # episodes in a row: more are too small to see
_MOST_PICTURES = 50  # of a film: more make the file large and nothing clearer
# Milliseconds between two pictures: in real time, unless that is too fast or too slow to watch.
_QUICKEST, _SLOWEST = 40, 100
_HOLD = 1500  # milliseconds that the last picture stays


class Filmed(NamedTuple):
    """An episode."""

    states: HostReadings  # `[time, ...]` each, up to the one that ended it if that can be drawn
    total_return: float
    solved: bool  # whether it reaches the goal region at some time
    pictures: Sequence[UInt8[np.ndarray, "height width 3"]] = ()
    """That its environment has drawn; none if states are to be drawn."""


def render(
    run: Positional[AnyRun],
    evaluation: AnyEvaluation = USUAL,
    *,
    task: int = 0,
    after: Sequence[int] | None = None,
    shown: int = 2,
    out: OptionalPath = None,
    family: AnyFamily = None,
    method: AnyMethod = None,
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
            before any adaptation, and the last one at most `episodes`. Of a policy with a memory
            they count the episodes of all its trials, a title those of one trial. None: 0, and half
            of `episodes`.
        shown: Episodes that are shown each time: the first ones that are played from then on.
        out: Directory of the pictures; None: `DIR/render`.
        family: The run's family as `module:name`, if it is your own.
        method: The run's method as `module:name`, if it is your own.

    Raises:
        RunError: an argument or the run cannot be used.
        RenderingError: the system has no library to draw with.
    """
    run, asked = open_run(run, family, method), evaluation
    each = asked.budget.per_update
    after = sorted(set(after or (0, asked.budget.episodes // each // 2 * each)))
    with refusals():
        asked.check_reached("after", after)
        check_number("shown", shown, 1, _MOST_SHOWN)
        check_number("task", task, 0, len(run.task_set(asked.tasks)) - 1)
    with new_tasks(run, asked) as (world, learner):
        env = world.env
        stride = math.ceil(env.horizon / _MOST_PICTURES)
        draws_itself = world.film(shown, stride, _SIZE)
        if not draws_itself:
            # Raises where pictures cannot be drawn, before minutes are spent on playing.
            Scene(env, View((-1.0, -1.0), (1.0, 1.0)), 1, 1).close()
        played = record_adaptation(learner, world, asked, task, after, shown)
        goal, trial = world.tasks[task], learner.capabilities.trial_episodes
    if not draws_itself:
        played = draw(env, goal, played, stride)
    name = f"{adaptation_file(run.directory, asked).stem}-task-{task}"
    title = f"{run.settings.method} on {env.name}\n{asked.reward} reward, {asked.tasks} task {task}"
    period = np.clip(round(1000 * stride * env.control_period), _QUICKEST, _SLOWEST)
    folder = run.directory / "render" if out is None else Path(out)
    paths = [folder / f"{name}.gif", folder / f"{name}.png"]
    named = with_names(played, each, trial is not None)
    for path, content in zip(paths, compose(title, named, int(period)), strict=True):
        write_whole(path, content)
    return paths


def record_adaptation(
    learner: AbstractFastLearner[Any],
    world: AbstractWorld,
    evaluation: Evaluation,
    task: int,
    after: Sequence[int],
    shown: int,
) -> dict[int, list[Filmed]]:
    """Adapt to one task as `maesn.adapt` does, and return some of the episodes.

    They are the first `shown` that are played after each of these numbers of episodes.
    """
    each = evaluation.budget.per_update
    played: dict[int, list[Filmed]] = {before: [] for before in after}

    def keep(episodes: Episodes, readings: Readings | HostReadings, update: int) -> None:
        for before in after:
            if 0 <= update * each - before < shown:
                numbers = range(min(each, shown))
                played[before] += [_filmed(world, episodes, readings, one) for one in numbers]

    episodes = (max(after) + shown - 1) // each * each
    collect = Collector(world, each, keep)
    played_alike = Evaluation(seed=evaluation.seed, action_noise=evaluation.action_noise)
    adapt(learner, collect, played_alike, episodes=episodes, tasks=[task])
    return {before: filmed[:shown] for before, filmed in played.items()}


def _filmed(
    world: AbstractWorld, episodes: Episodes, readings: Readings | HostReadings, number: int
) -> Filmed:
    valid, solved, returns = (
        np.asarray(x)[0, number]
        for x in (episodes.valid, episodes.solved, episodes.undiscounted_return)
    )
    states = {name: np.asarray(x)[: valid.sum() + 1, number] for name, x in readings.items()}
    if not all(np.isfinite(x[-1]).all() for x in states.values()):  # the physics blew up there
        states = {name: x[:-1] for name, x in states.items()}
    pictures = [at_once[number] for at_once in world.pictures]
    return Filmed(states, float(returns), bool((valid & solved).any()), pictures)


def draw(
    env: AnyEnv, task: Any, played: Mapping[int, Sequence[Filmed]], stride: int
) -> dict[int, list[Filmed]]:
    """Draw episodes from one place, one picture every `stride` steps."""
    first = next(iter(played.values()))[0]
    view = arena(env, jax.tree.map(lambda x: np.asarray(x)[None], task), first.states)
    times = [*range(0, env.horizon, stride), env.horizon]
    with closing(Scene(env, view, *_SIZE)) as scene:

        def with_pictures(episode: Filmed) -> Filmed:
            path, pictures = places(env, episode.states), []
            for time in times:
                now = min(time, len(path) - 1)  # an episode that has ended stands still
                trail = np.concatenate([path[:now:stride], path[now : now + 1]])
                state = {name: x[now] for name, x in episode.states.items()}
                pictures.append(scene.draw(state, task, trail))
            return episode._replace(pictures=pictures)

        return {before: [*map(with_pictures, episodes)] for before, episodes in played.items()}


def with_names(
    played: Mapping[int, Sequence[Filmed]], each: int, are_trials: bool
) -> dict[str, list[tuple[str, Filmed]]]:
    """Return a title for each number of episodes, and its episodes with their names.

    Of `each` episodes at a time; of a learner of trials, these are one episode of as many trials.
    """
    found = {}
    for before, episodes in played.items():
        known = before // each if are_trials else before
        when = f"after learning from {count_of(known)}" if before else "before adaptation"
        names = (
            f"trial {k % each + 1},\nepisode {known + k // each + 1}"
            if are_trials
            else f"episode {before + k + 1}"
            for k in range(len(episodes))
        )
        found[when] = [*zip(names, episodes, strict=True)]
    return found


@style.publication_style()
def compose(
    title: str, named: Mapping[str, Sequence[tuple[str, Filmed]]], milliseconds: int
) -> tuple[bytes, bytes]:
    """Return a GIF in which all episodes move at once, and a PNG of their last pictures.

    The film begins with these, because they stand where a film is not played. `named` is what
    `with_names` returns.
    """
    columns = max(map(len, named.values()))
    figure = style.new_figure(columns * _PANEL[0], len(named) * _PANEL[1])
    figure.suptitle(title, x=0.01, ha="left", fontsize=_TEXT)
    panels = figure.subplots(len(named), columns, squeeze=False)
    images = []
    for row, (when, episodes) in zip(panels, named.items(), strict=True):
        row[0].set_title(when, loc="left", fontsize=_TEXT)
        for axes, (name, episode) in zip(row, episodes, strict=True):
            images.append((axes.imshow(episode.pictures[-1]), episode.pictures))
            reached = ", goal reached" if episode.solved else ""
            colour = style.BLUISH_GREEN if episode.solved else style.DARK_GREY
            caption = f"{name}: return {episode.total_return:.1f}{reached}"
            axes.set(xticks=[], yticks=[])
            axes.set_xlabel(caption, color=colour, fontsize=_TEXT)
            axes.spines[:].set(visible=episode.solved, color=colour, linewidth=5)
    style.settle(figure)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    sheets = []
    for time in range(len(images[0][1])):
        for image, pictures in images:
            image.set_data(pictures[time])
            image.axes.draw_artist(image)
        sheets.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"))
    gif, png = io.BytesIO(), io.BytesIO()
    sheets[-1].save(png, "PNG")
    # One palette for all pictures: with palettes of their own, still areas would flicker.
    palette = sheets[-1].quantize(dither=Image.Dither.NONE)
    *others, last = (one.quantize(palette=palette, dither=Image.Dither.NONE) for one in sheets)
    durations = [_HOLD] + [milliseconds] * len(others)
    last.save(gif, "GIF", save_all=True, append_images=others, duration=durations, loop=0)
    return gif.getvalue(), png.getvalue()
