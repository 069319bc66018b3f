"""Build the page "Hide a goal" from the policies that come with the library.

    python docs/hide_a_goal/build.py

records episodes, writes `docs/site/hide_a_goal.html`, one file that needs no network, and prints
the share of goals that are found by attempt 5.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from games import ATTEMPTS, SEARCH, SEED, SHOWN, STRIDE, UNIT, Game, Recording, Robot, shares

from maesn import reporting
from maesn.envs.blockpush import BAND_HEIGHT, GOAL_X, LOWEST_Y, NUM_BLOCKS
from maesn.runs.run import Run
from maesn.runtime.return_model import ReturnPrior
from maesn.search import latent_of
from maesn.search.prior import LEAST_NOISE
from maesn.search.stored import prior_file, read_prior
from maesn.worlds.collector import Collector

HERE = Path(__file__).parent
ELEMENTS = Path(reporting.__file__).parent / "elements.js"  # of the report page as well
SOURCES = (HERE / "page.css", ELEMENTS, HERE / "page.js")
PAGE = HERE.parent / "site" / "hide_a_goal.html"
# Reward at the goal, reward lost per metre, and the norm; see `maesn.envs`.
REWARDS = {"wheeled": (0.0, 1.0, 2), "blockpush": (0.0, 5.0, 2), "ant": (4.0, 1.0, 1)}
EPISODES = {"wheeled": 4, "blockpush": 1, "ant": 4}  # of each latent; pushing starts exactly
TASKS = {"wheeled": (0,), "blockpush": (0, 1, 3), "ant": (0,)}  # of the test set: their layouts


@dataclass(frozen=True)
class Size:
    """How much is recorded, and where the page goes."""

    latents: int = 128
    """Of the archive, per robot."""
    draws: int = 20
    """Of N(0, I), per robot."""
    out: Path = PAGE


def covering(prior: ReturnPrior, count: int) -> np.ndarray:
    """Choose latents of an archive.

    The first half holds a good latent for every training task: each next one adds most to the best
    returns so far. The others lie each as far as possible from all before them.
    """
    best = np.full(len(prior.excess), prior.excess.min())
    apart, chosen = np.full(len(prior.latents), np.inf), list[int]()
    for number in range(count):
        gain = np.maximum(prior.excess - best[:, None], 0.0).sum(axis=0)
        score = np.where(apart > 0.0, gain if 2 * number < count else apart, -1.0)
        chosen.append(int(np.argmax(score)))
        best = np.maximum(best, prior.excess[:, chosen[-1]])
        way = np.linalg.norm(prior.latents - prior.latents[chosen[-1]], axis=1)
        apart = np.minimum(apart, way)
    return np.array(chosen)


def record(run: Run, latents: np.ndarray, task: int, episodes: int) -> Recording:
    """Play latents in one of the test tasks, without noise in the actions."""
    latent = latent_of(run.learner.fast_learner(run.latest_state()))
    latents, parts = latents.astype(np.float32), []
    with closing(run.world(run.task_set("test"), "sparse")) as world:
        collect, env, of_block = Collector(world, episodes), world.env, world.tasks[task]
        count = NUM_BLOCKS * hasattr(of_block, "block")
        blocks = [of_block._replace(block=block) for block in range(count)]

        def places(readings: Any) -> jax.Array:
            robot = env.position(env.observe(readings))
            return jnp.stack([robot, *(env.judged_position(readings, one) for one in blocks)])

        numbers = jnp.arange(len(latents))
        keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(SEED), numbers)
        for part in collect.parts(len(latents)):
            agents = replace(latent.holding(latents[part]), is_noisy=False)
            played, readings = collect.play(keys[part], agents, jnp.full(len(latents[part]), task))
            steps = np.asarray(played.valid.sum(-1))
            # [time, simulation, track, xy]
            tracks = np.asarray(jax.vmap(jax.vmap(places))(readings))
            tracks = np.moveaxis(tracks, 0, -1).reshape(*steps.shape, *tracks.shape[2:], -1)
            times = np.minimum(np.arange(tracks.shape[-1]), steps[..., None])
            stopped = np.take_along_axis(tracks, times[:, :, None, None], axis=-1)
            free = np.where(played.valid, played.reward - played.goal_reward, 0.0).sum(-1)
            parts.append((np.rint(stopped / UNIT).astype(np.int16), steps, free.round(4)))
    return Recording(latents.astype(np.float64), *map(np.concatenate, zip(*parts, strict=True)))


def prior_of(recording: Recording, robot: Robot) -> ReturnPrior:
    """Return the prior over the recorded returns, as `maesn prior` makes it of its own episodes."""
    offsets = robot.horizon * np.array([robot.far(goal) for goal in robot.training_goals])
    added = [robot.goal_returns(recording, goal, 0)[0] for goal in robot.training_goals]
    length = recording.steps / robot.horizon
    excess = np.stack(added) + recording.free - length * offsets[:, None, None]
    noise = excess.var(axis=2, ddof=1).mean(axis=0)
    return ReturnPrior(
        latents=recording.latents,
        excess=excess.mean(axis=2).astype(np.float32).astype(np.float64),  # as the page holds it
        noise=np.maximum(noise, LEAST_NOISE * noise.mean()),
        episodes=recording.steps.shape[1],
        offset_mean=float(offsets.mean()),
        offset_std=float(offsets.std(ddof=1)),
    )


def make_robot(name: str, size: Size) -> Robot:
    """Record a robot that comes with the library."""
    run = Run.open(name)
    with closing(run.world(reward_kind="sparse")) as world:
        stored, env = read_prior(prior_file(run, world.env))[0], world.env
    chosen = covering(stored, size.latents)
    draws = np.random.default_rng(SEED).standard_normal((size.draws, stored.latents.shape[1]))
    scenes = [
        tuple(record(run, z, task, EPISODES[name]) for z in (stored.latents[chosen], draws))
        for task in TASKS[name]
    ]
    # The returns of block pushing in the training tasks are those of other layouts.
    few = {name: getattr(stored, name)[..., chosen] for name in ("excess", "noise")}
    prior = replace(stored, latents=stored.latents[chosen], **few)
    goals = np.asarray(jax.vmap(env.goal)(run.training_tasks.tasks), np.float64)
    robot = Robot(name, env.sparse_radius, env.horizon, *REWARDS[name], goals, prior, scenes)
    return robot if name == "blockpush" else replace(robot, prior=prior_of(scenes[0][0], robot))


def hundred(robot: Robot) -> Iterator[Game]:
    """Yield scene, goal and track of 100 goals: the test set, or draws in the page's layouts."""
    if len(robot.scenes) == 1:
        for goal in Run.open(robot.name).task_set("test").tasks:
            yield 0, goal.astype(np.float64), 0
        return
    generator = np.random.default_rng(SEED)
    for game in range(100):
        scene, track = game % len(robot.scenes), 1 + int(generator.integers(NUM_BLOCKS))
        start = robot.scenes[scene][0].tracks[0, 0, track, 1, 0] * UNIT
        low = LOWEST_Y + BAND_HEIGHT * np.floor((start - LOWEST_Y) / BAND_HEIGHT)
        goal = generator.uniform((GOAL_X[0], low), (GOAL_X[1], low + BAND_HEIGHT))
        yield scene, goal, track


def write_page(robots: Sequence[Robot], out: Path) -> None:
    """Write the page, and print the share of goals found by attempt 5."""
    held = [shares(robot, list(hundred(robot))) for robot in robots]
    for robot, one in zip(robots, held, strict=True):
        for name, share in one.items():
            print(f"{robot.name} {name}: {share['found']:.0%} of goals found by attempt {SHOWN};")
            print(f"  of the attempts after it, {share['later']:.0%} reach the goal")
    document = {
        "robots": [robot.document() for robot in robots],
        "shares": held,
        "uniforms": np.random.default_rng(SEED).random(ATTEMPTS).tolist(),
        "settings": {
            name: getattr(SEARCH, name)
            for name in ("exploration", "residual", "length_scale", "familiar")
        },
        "stride": STRIDE,
    }
    page = (HERE / "page.html").read_text("utf-8")
    for path in SOURCES:
        page = page.replace(f"<!-- {path.name} -->", path.read_text("utf-8"), 1)
    out.write_text(page.replace("<!-- data -->", json.dumps(document, allow_nan=False), 1), "utf-8")
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB")


def main(size: Size) -> None:
    """Build the page."""
    write_page([make_robot(name, size) for name in REWARDS], size.out)


if __name__ == "__main__":
    main(tyro.cli(Size))
