"""What the page of runs says."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maesn.reporting.explorer import read_latent_paths, read_searches
from maesn.reporting.figures.learning import moving_mean
from maesn.reporting.page.charts import adaptation_charts, chart, plain_curve
from maesn.reporting.page.writing import rounded
from maesn.reporting.runs import (
    LearningCurve,
    RecordedExploration,
    RecordedRun,
    read_exploration,
    read_learning_curve,
    read_run,
)
from maesn.reporting.series import Series, check_world, group_series
from maesn.settings import leaves
from maesn.storage import read_json

_SHOWN_EPISODES = 50
_SMOOTHED = 1 / 30  # share of a run over which learning curves are averaged
_METRICS = {
    "return_after": "return after the inner update",
    "return_before": "return before the inner update",
    "success_after": "success after the inner update",
}
# Said where something is missing.
_NO_PLANE = "The family does not say where things are in a plane, so no paths can be shown."
_NO_LATENTS = "This method has no latent."
_NO_SEARCH = "There is no prior over returns yet: `maesn prior DIR` makes it, then report again."


def run_page(directories: Sequence[Path]) -> dict[str, Any]:
    """Return the document of the page of one run or several.

    What the latents do is shown of the first run that has recorded it.

    Raises:
        RunError: a file is missing or broken, or the runs cannot be compared.
    """
    runs = [read_run(path) for path in directories]
    check_world(runs)
    series = group_series(runs)
    shown = next((one for one in runs if read_latent_paths(one.path)), runs[0])
    explored = read_exploration(shown.path)
    return {
        "title": f"{' and '.join(one.label for one in series)} on {runs[0].family}",
        "subtitle": ", ".join(run.path.resolve().name for run in runs),
        "world": _world(explored),
        "explorer": _explorer(shown, explored),
        "search": _search(shown, explored),
        "learning": _learning(series),
        "adaptation": _adaptation(series),
        "exploration": _exploration(explored),
        "settings": _settings(runs),
    }


def _world(explored: RecordedExploration | None) -> dict[str, Any] | None:
    """Return goals and their regions in the plane."""
    if explored is None:
        return None
    return {
        "goals": rounded(explored.goals),
        "radius": explored.sparse_radius,
        "landmarks": None if explored.landmarks is None else rounded(explored.landmarks),
    }


def _explorer(run: RecordedRun, explored: RecordedExploration | None) -> dict[str, Any]:
    """Return the recorded path of each latent, and the tasks' adapted latents."""
    recorded = read_latent_paths(run.path)
    if explored is None:
        return {"missing": _NO_PLANE}
    if recorded is None:
        return {"missing": _NO_LATENTS}
    adapted = run.latents("test", "sparse")
    means = None if adapted is None else adapted.mean[:, -1]
    fits = means is not None and len(means) == len(explored.goals)
    return {
        "latents": rounded(recorded.latents),
        "paths": rounded(recorded.paths),
        "adapted": rounded(means) if fits else [],
    }


def _search(run: RecordedRun, explored: RecordedExploration | None) -> dict[str, Any]:
    """Return the recorded searches."""
    recorded = read_searches(run.path)
    if explored is None:
        return {"missing": _NO_PLANE}
    if recorded is None:
        return {"missing": _NO_SEARCH if read_latent_paths(run.path) else _NO_LATENTS}
    arrays = {name: rounded(value) for name, value in vars(recorded).items() if name != "edge"}
    beliefs = {name: rounded(getattr(recorded, name), 1) for name in ("mean", "std")}
    return {**arrays, **beliefs, "edge": recorded.edge}


def _learning(series: Sequence[Series]) -> list[dict[str, Any]]:
    lines = [(one, read_learning_curve(run.path)) for one in series for run in one.runs]
    known = [(one, found) for one, found in lines if found is not None]
    return [
        chart(text, "meta-iteration", text, [_smooth(one, found, name) for one, found in known])
        for name, text in _METRICS.items()
        if any(np.isfinite(getattr(found, name)).any() for _, found in known)
    ]


def _smooth(one: Series, found: LearningCurve, name: str) -> dict[str, Any]:
    window = 2 * int(len(found.iteration) * _SMOOTHED / 2) + 1
    values: np.ndarray = getattr(found, name)
    return plain_curve(one.style, found.iteration, moving_mean(values[None], window)[0])


def _adaptation(series: Sequence[Series]) -> list[dict[str, Any]]:
    """Return charts for each task set and reward that a run was adapted to."""
    runs = [run for one in series for run in one.runs]
    sets = dict.fromkeys((name.tasks, name.reward) for run in runs for name in run.tables())
    return [
        {
            "name": f"{tasks} tasks, {reward} reward",
            "charts": adaptation_charts(
                [line for one in series for line in one.adapted(tasks, reward)]
            ),
        }
        for tasks, reward in sets
    ]


def _exploration(explored: RecordedExploration | None) -> dict[str, Any]:
    """Return paths before any adaptation."""
    if explored is None:
        return {"missing": _NO_PLANE}
    panels: Mapping[str, Any] = {
        "trained, z drawn": explored.prior_paths,
        "trained, z fixed": explored.fixed_paths,
        "untrained": explored.untrained_paths,
    }
    return {
        "panels": [
            {"title": title, "paths": rounded(_thin(paths))}
            for title, paths in panels.items()
            if paths is not None
        ]
    }


def _thin(paths: np.ndarray) -> np.ndarray:
    times = np.linspace(0, paths.shape[1] - 1, 40).round().astype(int)
    return paths[:_SHOWN_EPISODES, times]


def _settings(runs: Sequence[RecordedRun]) -> dict[str, Any]:
    """Return all settings of the runs, one column each, and what made them."""
    columns = []
    for run in runs:
        config = read_json(run.path / "config.json")
        kept = ("settings", "learner", "world", "versions", "provenance")
        columns.append(leaves({name: config[name] for name in kept if config.get(name)}))
    names = list(dict.fromkeys(name for column in columns for name in column))
    return {
        "columns": ["setting", *(run.path.name for run in runs)],
        "rows": [[name, *(_text(column.get(name)) for column in columns)] for name in names],
    }


def _text(value: Any) -> str:
    return "" if value is None else str(value)
