"""Runs that take milliseconds: a learner that only drifts, and the real one made tiny."""

import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from maesn import GradientMetaLearner, maesn
from maesn.axes import Key
from maesn.experience.episodes import Collect
from maesn.learners import AbstractFastLearner, AbstractMetaLearner, Problem, baselines
from maesn.policies import GaussianMLP
from maesn.runs.checkpoint import read_checkpoint
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.runs.training import train


class DriftState(eqx.Module):
    position: Float[Array, " 3"]
    rows: Float[Array, "row 2"]
    iteration: Int[Array, ""]


class DriftInfo(eqx.Module):
    return_after: Float[Array, ""]
    nonfinite_tasks: Int[Array, ""]


class Drift(AbstractMetaLearner[DriftState, DriftInfo]):
    """A random walk with a row per task. It learns nothing, but compiles at once."""

    scale: float = 1.0
    nonfinite_from: int = 1000
    nonfinite_until: int = 1000

    def init(self, key: Key, problem: Problem) -> DriftState:
        rows = jax.random.normal(key, (problem.num_tasks, 2))
        return DriftState(jnp.zeros(3), rows, jnp.zeros((), int))

    def step(self, key: Key, state: DriftState, collect: Collect) -> tuple[DriftState, DriftInfo]:
        iteration = int(state.iteration)
        broken = self.nonfinite_from <= iteration < self.nonfinite_until
        drift = jnp.zeros(3) if broken else self.scale * jax.random.normal(key, (3,))
        moved = DriftState(state.position + drift, state.rows * 0.9, state.iteration + 1)
        score = jnp.asarray(jnp.nan) if broken else moved.position.sum()
        return moved, DriftInfo(score, jnp.asarray(4 if broken else 0))

    def planned_episodes(self, episodes_per_task: int, iterations: int) -> int:
        return 0

    def iteration(self, state: DriftState) -> Int[Array, ""]:
        return state.iteration

    def fast_learner(self, state: DriftState) -> AbstractFastLearner[Any]:
        return baselines(2, 2, "continuous")["zero action"]


def create(
    directory: Path, learner: AbstractMetaLearner[Any, Any] | None = None, **settings: Any
) -> Run:
    """A new run, of `Drift` if nothing else is said."""
    return Run.create(directory, Drift() if learner is None else learner, tiny_settings(**settings))


def finish(run: Run, iterations: int | None = None) -> Run:
    for _ in train(run, iterations):
        pass
    return run


def reopened(run: Run) -> Run:
    return Run.open(run.directory)


def metrics(run: Run) -> list[dict[str, Any]]:
    lines = (run.directory / "metrics.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


def tiny_maesn(**settings: Any) -> GradientMetaLearner:
    """The real learner, as small as it gets."""
    return maesn(**{"policy": GaussianMLP((8,)), "meta_batch_size": 4} | settings)


def tiny_settings(**settings: Any) -> RunSettings:
    defaults = {"family": "point", "episodes_per_task": 3, "iterations": 6, "checkpoint_every": 2}
    return RunSettings(**defaults | settings)


def create_tiny(directory: Path, **settings: Any) -> Run:
    return Run.create(directory, tiny_maesn(), tiny_settings(**settings))


def tensors(path: Path) -> dict[str, bytes]:
    """Every tensor of a checkpoint as type, shape and bytes."""
    values, _ = read_checkpoint(path)
    return {
        name: f"{value.dtype}{value.shape}".encode() + value.tobytes()
        for name, value in values.items()
    }


def outcome(run: Run) -> tuple[bytes, dict[str, bytes]]:
    """All that must not depend on how often a run was interrupted."""
    metrics = (run.directory / "metrics.jsonl").read_bytes()
    return metrics, tensors(run.checkpoints()[-1])


def goals(num_tasks: int) -> np.ndarray:
    """Goals of the family `point` that are in none of its sets."""
    angle = np.linspace(0.1, 3.0, num_tasks)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
