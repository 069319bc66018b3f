"""Build the page "Hide a goal" from the policies that come with the library.

    python docs/hide_a_goal/build.py

records episodes, writes `docs/site/hide_a_goal.html`, one file that needs no network, and prints
the share of goals that are found by attempt 5. The page searches among the recorded latents alone;
`transcript` is what it does, with the library's own search.
"""

import base64
import json
import zlib
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from maesn.envs.blockpush import BAND_HEIGHT, GOAL_X, LOWEST_Y, NUM_BLOCKS
from maesn.runs.run import Run
from maesn.runtime.posterior import Reading
from maesn.runtime.return_model import ReturnModel, ReturnPrior
from maesn.runtime.search import LatentSearch
from maesn.runtime.search_settings import SearchSettings
from maesn.search import latent_of
from maesn.search.prior import LEAST_NOISE
from maesn.search.stored import prior_file, read_prior
from maesn.worlds.collector import Collector

HERE = Path(__file__).parent
PAGE = HERE.parent / "site" / "hide_a_goal.html"
UNIT = 0.0005  # metres; positions are whole multiples of it
ATTEMPTS, SHOWN = 10, 5  # of a game; those within which a goal counts as found
SEARCH = SearchSettings(draws=0)
SEED = 0  # of the uniform numbers by which a search draws hypotheses, the same in every game
STRIDE = 7  # game g begins with draw 7 g of those of N(0, I)
# Reward at the goal, reward lost per metre, and the norm; see `maesn.envs`.
REWARDS = {"wheeled": (0.0, 1.0, 2), "blockpush": (0.0, 5.0, 2), "ant": (4.0, 1.0, 1)}
EPISODES = {"wheeled": 4, "blockpush": 1, "ant": 4}  # of each latent: the starts of a pusher are exact
TASKS = {"wheeled": (0,), "blockpush": (0, 1, 3), "ant": (0,)}  # of the test set; they fix the layout
PRIOR_NUMBERS = ("episodes", "offset_mean", "offset_std")

Document = dict[str, Any]


@dataclass(frozen=True)
class Size:
    """How much is recorded, and where the page goes."""

    latents: int = 128
    """Of the archive, per robot."""
    draws: int = 20
    """Of N(0, I), per robot."""
    out: Path = PAGE


@dataclass(frozen=True)
class Recording:
    """Episodes of some latents: what a visitor sees, and what a reward is computed from."""

    latents: np.ndarray
    """`[latent, z]`."""
    tracks: np.ndarray
    """Positions in `UNIT`, `[latent, episode, track, xy, time_plus_1]`: track 0 is the robot; then
    come the blocks, if there are any. After the end of an episode all stay where they are."""
    steps: np.ndarray
    """Length, `[latent, episode]`."""
    free: np.ndarray
    """The part of the return that is due to no goal, `[latent, episode]`."""

    def document(self) -> Document:
        """Return what the page holds of it."""
        rows = {name: getattr(self, name).tolist() for name in ("latents", "steps", "free")}
        twice = np.diff(self.tracks, n=2, prepend=np.zeros((*self.tracks.shape[:-1], 2), np.int16))
        return {**rows, "shape": self.tracks.shape, "tracks": packed(twice.astype(np.int16))}

    @staticmethod
    def of(document: Document) -> "Recording":
        """Return what `document` gave."""
        twice = unpacked(document["tracks"], np.int16, document["shape"])
        tracks = twice.cumsum(-1, dtype=np.int16).cumsum(-1, dtype=np.int16)
        return Recording(tracks=tracks, **{
            name: np.asarray(document[name]) for name in ("latents", "steps", "free")
        })  # fmt: skip


@dataclass(frozen=True)
class Robot:
    """A robot of the page: its goals, its rewards, its prior over returns, its recordings."""

    name: str
    radius: float
    """Sparse radius in metres."""
    horizon: int
    bonus: float
    """Reward at the goal."""
    scale: float
    """Reward lost per metre from the goal."""
    order: int
    """1 or 2: of the norm that measures this distance."""
    training_goals: np.ndarray
    prior: ReturnPrior
    scenes: Sequence[tuple[Recording, Recording]]
    """Layouts: latents of the archive, and draws of N(0, I)."""

    @cached_property
    def model(self) -> ReturnModel:
        """The model of returns that all searches share."""
        return SEARCH.model(self.prior)

    def document(self) -> Document:
        """Return what the page holds of it."""
        plain = ("name", "radius", "horizon", "bonus", "scale", "order")
        prior = {name: getattr(self.prior, name) for name in PRIOR_NUMBERS} | {
            "noise": self.prior.noise.tolist(),
            "excess": packed(self.prior.excess.astype(np.float32)),
            "jump": self.model.unlike().jump,  # from eigenvalues, which the page does not compute
        }
        return {name: getattr(self, name) for name in plain} | {
            "goals": self.training_goals.tolist(),
            "prior": prior,
            "scenes": [[one.document() for one in scene] for scene in self.scenes],
        }

    @staticmethod
    def of(document: Document) -> "Robot":
        """Return what `document` gave."""
        own = {name: value for name, value in document.items() if name in Robot.__annotations__}
        scenes = [tuple(map(Recording.of, scene)) for scene in document["scenes"]]
        goals, held = np.asarray(document["goals"]), document["prior"]
        latents = scenes[0][0].latents
        excess = unpacked(held["excess"], np.float32, (len(goals), len(latents)))
        numbers = {name: held[name] for name in PRIOR_NUMBERS}
        noise = np.asarray(held["noise"])
        prior = ReturnPrior(latents, excess.astype(np.float64), noise, **numbers)
        return Robot(**own | {"training_goals": goals, "prior": prior, "scenes": scenes})

    def far(self, goal: np.ndarray) -> float:
        """Return the reward of a step far from a goal."""
        return float(self.bonus - self.scale * np.linalg.norm(goal, ord=self.order))

    def goal_returns(
        self, recording: Recording, goal: np.ndarray, track: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return what a goal adds to returns, and whether it is reached, `[latent, episode]`."""
        way = recording.tracks[:, :, track, :, 1:] * UNIT - goal[:, None]
        distance = np.sqrt(way[:, :, 0] ** 2 + way[:, :, 1] ** 2)
        played = np.arange(distance.shape[-1]) < recording.steps[..., None]
        near = (distance <= self.radius) & played
        judged = distance if self.order == 2 else np.abs(way).sum(2)
        reward = np.where(near, self.bonus - self.scale * judged, self.far(goal))
        return np.where(played, reward, 0.0).sum(-1), near.any(-1)


def packed(array: np.ndarray) -> str:
    """Return an array as text: its bytes, all first ones first, compressed, in base 64."""
    planes = np.ascontiguousarray(array).reshape(-1).view(np.uint8).reshape(-1, array.itemsize).T
    return base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode()


def unpacked(text: str, kind: Any, shape: Sequence[int]) -> np.ndarray:
    """Return what `packed` was given."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    return planes.reshape(np.dtype(kind).itemsize, -1).T.copy().view(kind).reshape(shape)


def transcript(robot: Robot, scene: int, goal: np.ndarray, track: int) -> list[Document]:
    """Search for a goal among the recorded latents, as the page does; one row per attempt."""
    recording, rows = robot.scenes[scene][0], []
    added, reached = robot.goal_returns(recording, goal, track)
    returns = added + recording.free
    search, generator = LatentSearch.start(robot.model, SEARCH), np.random.default_rng(SEED)
    for attempt in range(ATTEMPTS):
        search, point = search.proposed(generator)
        one = point, attempt % returns.shape[1]
        length = float(recording.steps[one] / robot.horizon)
        search = search.after([Reading(point, float(returns[one]), length)])
        beliefs = search.posterior
        rows.append(
            {"point": point, "return": float(returns[one]), "reached": bool(reached[one])}
            | {"mean": beliefs.mean, "std": beliefs.std, "familiar": beliefs.familiar}
        )
    return rows


def shares(robot: Robot, games: Sequence[tuple[int, np.ndarray, int]]) -> Document:
    """Return for search and for draws of N(0, I) what share of goals is found by attempt 5, and
    what share of the later attempts reaches the goal."""
    searched, drawn = [], []
    for game, (scene, goal, track) in enumerate(games):
        searched.append([row["reached"] for row in transcript(robot, scene, goal, track)])
        _, reached = robot.goal_returns(robot.scenes[scene][1], goal, track)
        attempts = np.arange(ATTEMPTS)
        rows = (STRIDE * game + attempts) % len(reached), attempts % reached.shape[1]
        drawn.append(reached[rows].tolist())
    return {
        name: {"found": float(hits[:, :SHOWN].any(1).mean()), "later": float(hits[:, SHOWN:].mean())}
        for name, hits in (("search", np.array(searched)), ("draws", np.array(drawn)))
    }


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
        blocks = [of_block._replace(block=b) for b in range(NUM_BLOCKS * hasattr(of_block, "block"))]

        def places(readings: Any) -> jax.Array:
            robot = env.position(env.observe(readings))
            return jnp.stack([robot, *(env.judged_position(readings, one) for one in blocks)])

        keys = jax.random.split(jax.random.key(SEED), len(latents))
        for part in collect.parts(len(latents)):
            agents = replace(latent.holding(latents[part]), is_noisy=False)
            played, readings = collect.play(keys[part], agents, jnp.full(len(latents[part]), task))
            steps = np.asarray(played.valid.sum(-1))
            tracks = np.asarray(jax.vmap(jax.vmap(places))(readings))  # [time, simulation, track, xy]
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
        stored, env = read_prior(prior_file(run, world))[0], world.env
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


def games(robot: Robot) -> Iterator[tuple[int, np.ndarray, int]]:
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
    held = [shares(robot, list(games(robot))) for robot in robots]
    for robot, one in zip(robots, held, strict=True):
        for name, share in one.items():
            print(f"{robot.name} {name}: {share['found']:.0%} of goals found by attempt {SHOWN}, ", end="")
            print(f"{share['later']:.0%} of later attempts at the goal")
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
    for name in ("page.css", "page.js"):
        page = page.replace(f"<!-- {name} -->", (HERE / name).read_text("utf-8"), 1)
    out.write_text(page.replace("<!-- data -->", json.dumps(document, allow_nan=False), 1), "utf-8")
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB")


def read_page(path: Path = PAGE) -> list[Robot]:
    """Return the robots of a page."""
    text = path.read_text("utf-8").split('id="data">', 1)[1].split("</script>", 1)[0]
    return [Robot.of(one) for one in json.loads(text)["robots"]]


def main(size: Size) -> None:
    """Build the page."""
    write_page([make_robot(name, size) for name in REWARDS], size.out)


if __name__ == "__main__":
    main(tyro.cli(Size))
