"""Small synthetic runs whose numbers are known, as records and as run directories."""

import csv
import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maesn.reporting.comparison import Line
from maesn.reporting.reading import COLUMNS, EXPLORE, MEASURES, AdaptationTable, stack_seeds
from maesn.reporting.runs import (
    BELIEF,
    LATENT_PATHS,
    SEARCHES,
    Latents,
    LearningCurve,
    RecordedExploration,
    RecordedRun,
)
from maesn.reporting.sources import Series, group_series
from maesn.reporting.style import METHOD_STYLES, MethodStyle

NUM_TASKS, NUM_EPISODES, NUM_UPDATES = 8, 5, 3
RADIUS = 0.8


def half_circle(num_goals: int) -> np.ndarray:
    angle = np.linspace(0.1, np.pi - 0.1, num_goals)
    return 2.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def fan(directions: np.ndarray, length: float, num_steps: int = 20) -> np.ndarray:
    """Straight paths from the origin, `[episode, time_plus_1, 2]`."""
    ends = length * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    return np.linspace(0.0, 1.0, num_steps + 1)[:, None] * ends[:, None]


def adaptation_table(
    num_tasks: int = NUM_TASKS, seed: int = 0, gain: float = 50.0
) -> AdaptationTable:
    noise = np.random.default_rng(seed).normal(size=(num_tasks, NUM_UPDATES + 1))
    progress = 1.0 - 0.5 ** np.arange(NUM_UPDATES + 1)
    rate = np.clip(0.1 + 0.6 * progress + 0.05 * noise, 0.0, 1.0)
    return AdaptationTable(
        tasks="test",
        reward="sparse",
        purpose=EXPLORE,
        updates=np.arange(NUM_UPDATES + 1),
        episodes=50 * np.arange(NUM_UPDATES + 1),
        mean_return=-396.0 + gain * progress + noise,
        goal_return=-390.0 + gain * progress + noise,
        success_rate=rate,
        final_success_rate=0.8 * rate,
        time_in_region=0.3 * rate,
        solved_at_reset=np.zeros_like(rate),
        explored_success_rate=rate,
    )


def columns(table: AdaptationTable, chosen: slice) -> AdaptationTable:
    """Some columns of a table."""
    curves = {name: x[..., chosen] for name, x in table.curves.items()}
    shown = {"updates": table.updates[chosen], "episodes": table.episodes[chosen]}
    return dataclasses.replace(table, **curves, **shown)


def exploration(*, has_latents: bool = True) -> RecordedExploration:
    directions = np.linspace(0.2, np.pi - 0.2, NUM_EPISODES)
    return RecordedExploration(
        training_goals=half_circle(10),
        goals=half_circle(NUM_TASKS),
        sparse_radius=RADIUS,
        prior_paths=fan(directions, 2.0),
        untrained_paths=fan(directions, 0.3),
        fixed_paths=fan(np.full(NUM_EPISODES, 1.0), 2.0) if has_latents else None,
        prior_latents=np.random.default_rng(0).normal(size=(NUM_EPISODES, 2))
        if has_latents
        else None,
        untrained_success_rate=np.array([0.0, 0.1, 0.0, 0.0, 0.5, 0.0, 0.0, 1.0]),
        solved_at_reset=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        episodes_per_task=10,
    )


def latents(num_components: int = 2) -> Latents:
    """The prior, then means on a circle; each component's spread is its number, from 1."""
    mean = np.zeros((NUM_TASKS, NUM_UPDATES + 1, num_components))
    angle = np.linspace(0.0, np.pi, NUM_TASKS)
    mean[:, -1] = np.cos(angle)[:, None] * np.arange(1, num_components + 1)
    log_std = np.zeros_like(mean)
    log_std[:, -1] = np.log(0.5)
    return Latents(mean, log_std, 0)


def learning_curve(num_iterations: int = 30, level: float = -400.0) -> LearningCurve:
    iteration = np.arange(1.0, num_iterations + 1)
    return LearningCurve(
        iteration=iteration,
        return_before=np.full(num_iterations, level),
        return_after=level + iteration,
        success_after=iteration / num_iterations,
    )


def run(
    method: str = "maesn", seed: int = 0, learner: dict[str, Any] | None = None, **settings: Any
) -> RecordedRun:
    everything = {
        "method": method,
        "family": "wheeled",
        "variant": "reference",
        "reward": "dense",
        "sparse_radius": None,
        "seed": seed,
        "iterations": 30,
        "learner": learner or {},
        **settings,
    }
    path = Path(f"runs/{method}-{seed}")
    return RecordedRun(path, method, everything["family"], seed, everything)


def series(*methods: str) -> list[Series]:
    return group_series([run(method) for method in methods])


def line(method: str = "maesn", *tables: AdaptationTable) -> Line:
    """A method's adaptation, one table per seed."""
    style = METHOD_STYLES.get(method, MethodStyle(method, "#000000", "-", "o"))
    return Line(method, style, tuple(range(len(tables))), stack_seeds(tables))


def write_adaptation(
    path: Path, table: AdaptationTable, deployed: AdaptationTable | None = None
) -> None:
    """Write a table of episodes that are learned from, and of a deployed agent's if given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for purpose, rows in (("explore", table), ("deploy", deployed)):
            if rows is not None:
                writer.writerows(_rows(rows, purpose))


def _rows(table: AdaptationTable, purpose: str) -> Iterator[list[Any]]:
    curves = [getattr(table, name) for name in (*MEASURES, "solved_at_reset")]
    for task, column in np.ndindex(table.mean_return.shape):
        measures = (float(curve[task, column]) for curve in curves)
        yield [task, table.updates[column], table.episodes[column], purpose, *measures]


def write_metrics(path: Path, curve: LearningCurve) -> None:
    names = ("iteration", "return_before", "return_after", "success_after")
    rows = zip(*(getattr(curve, name) for name in names), strict=True)
    lines = [json.dumps(dict(zip(names, row, strict=True))) for row in rows]
    path.write_text("".join(line + "\n" for line in lines), encoding="utf-8")


def write_exploration(path: Path, content: RecordedExploration) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {name: value for name, value in vars(content).items() if value is not None}
    np.savez(path, **arrays)


def write_explorer(directory: Path) -> None:
    """Write paths that lead where the latent points, searches and a belief that find that out."""
    draw = np.random.default_rng(0)
    axis = np.linspace(-3.0, 3.0, 5)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    paths = np.linspace(0.0, 1.0, 6)[:, None] * points[:, None]
    beliefs = draw.normal(size=(2, 2, 4, 5, 5))
    searches = {
        "task": np.arange(2.0),
        "edge": 3.0,
        "played": draw.normal(size=(2, 3, 2)),
        "returns": np.array([[-300.0, -250.5, -200.0], [-310.0, -260.0, -210.0]]),
        "reached": np.array([[0.0, 1.0, 1.0], [0.0, 0.0, 0.0]]),
        "paths": draw.normal(size=(2, 3, 6, 2)),
        "deployed": draw.normal(size=(2, 4, 2)),
        "mean": beliefs[0],
        "std": np.abs(beliefs[1]),
        "interval": np.sort(draw.uniform(-300.0, -200.0, (2, 4, 2)), axis=-1),
        "familiar": np.linspace(0.7, 1.0, 8).reshape(2, 4),
    }
    sure = np.linspace(0.0, 1.0, 7)[:, None]
    belief = {
        "task": 1,
        "step": np.arange(7.0),
        "mean": 2.0 * sure * np.array([1.0, -1.0]),
        "std": 1.0 - 0.9 * sure * np.ones(2),
        "predicted": 0.5 + sure[..., None] * np.linspace(-0.5, 0.5, 16).reshape(4, 4),
        "corners": np.array([[-2.0, -1.0], [2.0, 3.0]]),
        "paths": np.cumsum(draw.normal(size=(2, 4, 2)), axis=1),
    }
    (directory / "figures").mkdir(exist_ok=True)
    np.savez(directory / BELIEF, **belief)
    np.savez(directory / LATENT_PATHS, latents=points, paths=paths)
    np.savez(directory / SEARCHES, **searches)


def write_run(
    directory: Path, method: str = "maesn", without: Sequence[str] = (), **settings: Any
) -> Path:
    """Write a whole run directory, except for what `without` names."""
    directory.mkdir()
    record = run(method, **settings)
    settings = dict(record.settings)
    config = {"schema": 1, "learner": settings.pop("learner"), "settings": settings}
    (directory / "config.json").write_text(json.dumps(config), encoding="utf-8")
    has_latents = method in ("maesn", "latent_space")
    if "metrics" not in without:
        write_metrics(directory / "metrics.jsonl", learning_curve())
    if "adaptation" not in without:
        table = directory / "adaptation" / "test-sparse.csv"
        write_adaptation(table, adaptation_table(seed=record.seed))
        if has_latents:
            np.savez(table.with_suffix(".latents.npz"), **vars(latents()))
    if has_latents and "explorer" not in without:
        write_explorer(directory)
    if "exploration" not in without:
        write_exploration(
            directory / "figures" / "exploration.npz", exploration(has_latents=has_latents)
        )
    return directory
