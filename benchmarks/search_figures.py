"""Draw what a search believes and does in one task, and what it returns beside other rules.

    python benchmarks/search_figures.py wheeled --out docs/figures

draws `search-beliefs.png` and `search-trajectories.png` of one test task of a policy that comes
with the library. With `--curves results/search/curves.csv`, the numbers that `search_tables.py`
writes, it also draws `search-returns.png`.
"""

import csv
import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import new_tasks
from maesn.reporting import style
from maesn.rules import SearchRule
from maesn.runs.run import Run
from maesn.runtime.search import LatentSearch, SearchSettings
from maesn.worlds.collector import Collector

SHOWN = (0, 1, 3, 5, 10)  # episodes after which beliefs are drawn
TRAJECTORIES = 8
EDGE = 8.0  # of the latents that are drawn, in standard deviations of the prior
POINTS = 71  # along each axis

RUNS = ("wheeled", "ant", "blockpush")
# Line of the tables -> what it is called, which of its numbers is drawn, and how.
LINES = {
    "search": ("search", "deployed", style.VERMILLION, "-o"),
    "cma_es": ("CMA-ES", "deployed", style.SKY_BLUE, "-D"),
    "cross_entropy": ("cross-entropy", "deployed", style.BLUE, "-^"),
    "best_of_wide": ("best of draws", "deployed", style.GREY, "-s"),
    "gradient": ("gradient, at the mean", "deployed", style.VERMILLION, "--v"),
}
DRAWN = ("gradient", ("gradient, z drawn", "drawn", style.VERMILLION, ":v"))


@dataclasses.dataclass(frozen=True)
class Settings:
    """What is drawn."""

    run: tyro.conf.Positional[str]
    """A run, or the name of a policy that comes with the library."""
    out: Path = Path("figures")
    """Directory of the figures."""
    task: int = 5
    """Of the test tasks."""
    seed: int = 0
    """Of the episodes."""
    curves: Path | None = None
    """Numbers of `search_tables.py`."""


@dataclasses.dataclass(frozen=True)
class Searched:
    """A search in one task: what it knew before each episode, and where the episodes went."""

    searches: list[LatentSearch]
    played: list[np.ndarray]
    paths: list[np.ndarray]
    goal: np.ndarray
    radius: float


def search(settings: Settings) -> Searched:
    """Play a search in one task."""
    run = Run.open(settings.run)
    evaluation = Evaluation(rule=SearchRule(SearchSettings(draws=0)), seed=settings.seed)
    searches, played, paths = [], [], []
    with new_tasks(run, evaluation) as (world, learner):
        collect, slot = Collector(world, 1), jnp.asarray([settings.task])
        keys = jax.random.split(jax.random.key(settings.seed), 1)
        state: Any = learner.init(keys)
        for episode in range(max(SHOWN) + 1):
            searches.append(state.searches[0])
            played.append(state.searches[0].points[state.chosen[0][0]])
            episode_keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys, episode)
            episodes = collect(episode_keys, learner.agents(state), slot)
            paths.append(np.asarray(jax.vmap(world.env.position)(episodes.observation[0, 0])))
            state = learner.update(state, episodes)
        goal = np.asarray(world.env.goal(world.tasks[settings.task]))
        return Searched(searches, played, paths, goal, world.env.sparse_radius)


def draw_beliefs(found: Searched) -> Figure:
    """Draw the posterior mean over a latent space of two dimensions, and what was played."""
    axis = np.linspace(-EDGE, EDGE, POINTS)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    figure, panels = plt.subplots(
        1, len(SHOWN), figsize=(style.TWO_COLUMNS, 1.9), sharey=True, layout="constrained"
    )
    means = []
    for count in SHOWN:
        one = found.searches[count]
        more = one.posterior.extended(grid)
        means.append(more.mean[len(one.points) :].reshape(POINTS, POINTS))
    limits = (min(map(np.min, means)), max(map(np.max, means)))
    for panel, count, mean in zip(panels, SHOWN, means, strict=True):
        image = panel.pcolormesh(axis, axis, mean, vmin=limits[0], vmax=limits[1], rasterized=True)
        if count:
            panel.plot(
                *np.stack(found.played[:count]).T, "o", color="white", ms=3, mec="black", mew=0.5
            )
        one = found.searches[count]
        panel.plot(*one.points[one.best], "*", color=style.VERMILLION, ms=8, mec="white", mew=0.6)
        panel.set(
            title=f"after {count} episode{'s' * (count != 1)}", xlabel="$z_1$", aspect="equal"
        )
    panels[0].set_ylabel("$z_2$")
    figure.colorbar(image, ax=panels, label="excess return", pad=0.01)
    return figure


def draw_trajectories(found: Searched) -> Figure:
    """Draw where the first episodes went."""
    figure, axes = plt.subplots(figsize=(style.TWO_COLUMNS, 3.0), layout="constrained")
    region = Circle(tuple(found.goal), found.radius, color=style.BLUISH_GREEN, alpha=0.25, lw=0)
    axes.add_patch(region)
    axes.plot(*found.goal, "*", color=style.BLUISH_GREEN, ms=10)
    colours = plt.get_cmap("viridis")(np.linspace(0, 0.95, TRAJECTORIES))
    for number, (path, colour) in enumerate(zip(found.paths, colours, strict=False), start=1):
        axes.plot(*path.T, color=colour)
        axes.annotate(str(number), path[-1], color=colour, weight="bold")
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="the first eight episodes")
    return figure


def draw_returns(path: Path) -> Figure:
    """Draw mean return over the episodes in the new task, on a logarithmic axis from 1."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    runs = [run for run in RUNS if any(row["run"] == run for row in rows)]
    figure, panels = plt.subplots(
        1, len(runs), figsize=(style.TWO_COLUMNS, 2.6), layout="constrained", squeeze=False
    )
    for run, axes in zip(runs, panels[0], strict=True):
        for line, (label, value, colour, look) in (*LINES.items(), DRAWN):
            own = [row for row in rows if (row["run"], row["line"]) == (run, line) and row[value]]
            # What is known before any episode stands left of the first.
            episodes = np.maximum([float(row["episodes"]) for row in own], 0.5)
            mean, half = (
                np.array([float(row[n]) for row in own]) for n in (value, f"{value}_half")
            )
            axes.plot(episodes, mean, look, color=colour, ms=2.5, label=label)
            axes.fill_between(episodes, mean - half, mean + half, color=colour, alpha=0.12, lw=0)
        for row in rows:
            if (row["run"], row["line"]) == (run, "ceiling"):
                best = float(row["deployed"])
                axes.axhline(best, color=style.DARK_GREY, ls=":", label="best latent in hindsight")
        axes.set(xscale="log", xlabel="episodes in the new task", title=run)
        axes.set_xticks([0.5, 1, 5, 20, 100, 500], ["0", "1", "5", "20", "100", "500"])
    panels[0, 0].set_ylabel("return")
    labels = panels[0, -1].get_legend_handles_labels()
    figure.legend(*labels, loc="outside lower center", ncols=4)
    return figure


def main(settings: Settings) -> None:
    """Draw the figures."""
    settings.out.mkdir(parents=True, exist_ok=True)
    found = search(settings)
    with style.publication_style():
        figures = {"beliefs": draw_beliefs(found), "trajectories": draw_trajectories(found)}
        if settings.curves is not None:
            figures["returns"] = draw_returns(settings.curves)
        for name, figure in figures.items():
            path = settings.out / f"search-{name}.png"
            figure.savefig(path)
            print(path)


if __name__ == "__main__":
    main(tyro.cli(Settings))
