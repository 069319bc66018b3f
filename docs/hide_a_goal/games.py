"""Games of "Hide a goal": recorded episodes, their returns for any goal, and a search among them.

`transcript` is what the page does, with the library's own search.
"""

import base64
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from maesn.runtime.posterior import Reading
from maesn.runtime.return_model import ReturnModel, ReturnPrior
from maesn.runtime.search import LatentSearch, SearchSettings

UNIT = 0.0005  # metres; positions are whole multiples of it
ATTEMPTS, SHOWN = 10, 5  # of a game; those within which a goal counts as found
SEARCH = SearchSettings(draws=0)
SEED = 0  # of the uniform numbers by which a search draws hypotheses, the same in every game
STRIDE = 7  # game g begins with draw 7 g of those of N(0, I)
PRIOR_NUMBERS = ("episodes", "offset_mean", "offset_std")

Document: TypeAlias = dict[str, Any]
Game: TypeAlias = tuple[int, np.ndarray, int]
"""Scene, goal in metres, and the track that is to reach it."""


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
            "jump": self.model.jump,  # from eigenvalues, which the page does not compute
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


def shares(robot: Robot, games: Sequence[Game]) -> Document:
    """Return what share of goals is found by attempt 5, and of later attempts is at the goal.

    Both are given for search and for draws of N(0, I).
    """
    searched, drawn = [], []
    for game, (scene, goal, track) in enumerate(games):
        searched.append([row["reached"] for row in transcript(robot, scene, goal, track)])
        _, reached = robot.goal_returns(robot.scenes[scene][1], goal, track)
        attempts = np.arange(ATTEMPTS)
        rows = (STRIDE * game + attempts) % len(reached), attempts % reached.shape[1]
        drawn.append(reached[rows].tolist())
    hits = {"search": np.array(searched), "draws": np.array(drawn)}
    return {
        name: {"found": float(hit[:, :SHOWN].any(1).mean()), "later": float(hit[:, SHOWN:].mean())}
        for name, hit in hits.items()
    }


def read_page(path: Path) -> list[Robot]:
    """Return the robots of a page."""
    text = path.read_text("utf-8").split('id="data">', 1)[1].split("</script>", 1)[0]
    return [Robot.of(one) for one in json.loads(text)["robots"]]
