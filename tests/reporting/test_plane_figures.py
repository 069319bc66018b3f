"""Figures of the plane: what is drawn is the data, with units and shared limits."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from figure_checks import check_saved_whole, crowd, ellipses, legend, line, segments
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from synthetic_runs import (
    NUM_EPISODES,
    NUM_TASKS,
    RADIUS,
    adaptation_table,
    exploration,
    fan,
    half_circle,
    latents,
)

from maesn.reporting.figures.exploration import (
    direction_scale,
    directions,
    plot_exploration,
    plot_latents,
    plot_structured_noise,
    plot_task_distribution,
    shared_limits,
)
from maesn.reporting.runs import RecordedExploration
from maesn.reporting.style import METHOD_STYLES


def exploration_figure() -> Figure:
    maesn, maml = METHOD_STYLES["maesn"], METHOD_STYLES["maml"]
    return plot_exploration(
        [
            (maesn, exploration(), adaptation_table().prior_reach),
            (maml, exploration(has_latents=False), ""),
        ]
    )


def crowded_exploration_figure() -> Figure:
    reach = adaptation_table().prior_reach
    return plot_exploration([(one.style, exploration(), reach) for one in crowd()])


FIGURES: dict[str, Callable[[], Figure]] = {
    "exploration": exploration_figure,
    "crowded exploration": crowded_exploration_figure,
    "tasks": lambda: plot_task_distribution(exploration()),
    "latents": lambda: plot_latents(latents(), half_circle(NUM_TASKS)),
    "noise": lambda: plot_structured_noise(exploration()),
}


@pytest.mark.parametrize("make", FIGURES.values(), ids=FIGURES)
def test_every_figure_is_saved_with_nothing_cut_off(
    tmp_path: Path, make: Callable[[], Figure]
) -> None:
    check_saved_whole(make(), tmp_path)


def test_exploration() -> None:
    figure = exploration_figure()
    maesn, maml, untrained = figure.axes
    share = round(100 * float((adaptation_table().success_rate[:, 0] > 0).mean()))
    assert maesn.get_title() == f"MAESN\n{share}% of the goals in 50 episodes"
    assert maml.get_title() == "MAML"
    assert untrained.get_title() == "untrained policy\n29% of the goals in 10 episodes"
    np.testing.assert_array_equal(segments(maesn), exploration().prior_paths)
    np.testing.assert_array_equal(segments(untrained), exploration().untrained_paths)
    for axes in figure.axes:
        assert axes.get_aspect() == 1.0
        assert axes.get_xlabel() == "x (m)"
        assert (axes.get_xlim(), axes.get_ylim()) == (maesn.get_xlim(), maesn.get_ylim())
        np.testing.assert_array_equal(ellipses(axes).get_offsets(), half_circle(NUM_TASKS))
        assert set(ellipses(axes).get_widths()) == {2 * RADIUS}
    assert maesn.get_ylabel() == "y (m)"


def test_the_share_of_the_untrained_policy_leaves_out_what_is_solved_at_reset() -> None:
    def title(recorded: RecordedExploration) -> str:
        drawn = plot_exploration([(METHOD_STYLES["maesn"], recorded, "")])
        return str(drawn.axes[-1].get_title())

    # 2 of the 7 tasks that are not solved at reset.
    assert title(exploration()) == "untrained policy\n29% of the goals in 10 episodes"
    everything = replace(exploration(), solved_at_reset=np.ones(NUM_TASKS))
    assert title(everything) == "untrained policy"


def test_limits_hold_discs_and_paths_and_colours_cover_directions() -> None:
    goals, paths = np.array([[0.0, 2.0]]), fan(np.array([0.0]), 3.0)
    limits = shared_limits([goals, paths], radius=0.5)
    assert (limits.min < [-0.5, 0.0]).all()
    assert (limits.max > [3.0, 2.5]).all()
    assert limits.height < limits.width
    goals = np.array([[1.0, 0.0], [0.0, 2.0], [-3.0, 0.0]])
    np.testing.assert_allclose(directions(goals), [0.0, 90.0, 180.0])
    assert direction_scale(goals[:2]).get_clim() == (0.0, 90.0)
    assert direction_scale(goals[:1]).get_clim() == (0.0, 30.0)


def test_task_distribution() -> None:
    figure = plot_task_distribution(exploration())
    (axes,) = figure.axes
    assert legend(figure) == [
        "10 training goals",
        "8 goals adapted to",
        "start",
        "goal region (0.8 m)",
    ]
    for label, goals in (("10 training goals", 10), ("8 goals adapted to", NUM_TASKS)):
        np.testing.assert_array_equal(line(axes, label), np.unique(half_circle(goals), axis=0))
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_aspect()) == ("x (m)", "y (m)", 1.0)
    (disc,) = axes.patches
    assert isinstance(disc, Circle)
    assert disc.get_radius() == RADIUS


def test_task_distribution_shows_what_tasks_lay_out_beside_goals() -> None:
    # Nine tasks share a layout, whose objects are drawn once.
    layout = np.array([[0.4, 0.1], [0.5, -0.3]])
    training = np.stack([layout] * 9 + [layout + 5.0])
    adapted_to = np.stack([layout - 5.0] * NUM_TASKS)
    figure = plot_task_distribution(
        replace(exploration(), training_landmarks=training, landmarks=adapted_to)
    )
    (axes,) = figure.axes
    drawn = line(axes, "objects of training tasks")
    np.testing.assert_array_equal(drawn, np.concatenate([layout, layout + 5.0]))
    np.testing.assert_array_equal(line(axes, "objects of tasks adapted to"), layout - 5.0)


def test_latents() -> None:
    figure = plot_latents(latents(), half_circle(NUM_TASKS))
    before, after, bar = figure.axes
    assert (before.get_title(), after.get_title()) == ("before adaptation", "after update 3")
    assert legend(figure) == ["prior N(0, I), 1σ", "a task's latent distribution, 1σ"]
    assert bar.get_ylabel() == "direction of the goal (°)"
    np.testing.assert_allclose(ellipses(before).get_widths(), 2.0)  # 1 sigma of the prior
    np.testing.assert_allclose(ellipses(after).get_heights(), 1.0)
    np.testing.assert_array_equal(ellipses(after).get_offsets(), latents().mean[:, -1])
    colours = ellipses(after).get_edgecolor()
    assert len({tuple(colour) for colour in colours}) == NUM_TASKS
    for axes in (before, after):
        assert (axes.get_xlim(), axes.get_ylim()) == (after.get_xlim(), after.get_ylim())
        (prior,) = axes.patches
        assert isinstance(prior, Circle)
        assert (prior.get_radius(), tuple(prior.center)) == (1.0, (0.0, 0.0))


def test_latents_show_the_components_that_spread_most() -> None:
    axes = plot_latents(latents(num_components=4)).axes
    assert len(axes) == 2  # without goals there is no scale of directions
    assert (axes[0].get_xlabel(), axes[0].get_ylabel()) == (
        "latent component 3",
        "latent component 4",
    )


def test_structured_noise() -> None:
    figure = plot_structured_noise(exploration())
    sampled, fixed, bar = figure.axes
    assert sampled.get_title().startswith("z sampled from the prior\n")
    # All episodes with the fixed latent end in one place.
    assert fixed.get_title() == "z fixed\nfinal positions spread 0.00 m"
    assert (sampled.get_xlim(), sampled.get_ylim()) == (fixed.get_xlim(), fixed.get_ylim())
    assert sampled.get_aspect() == fixed.get_aspect() == 1.0
    np.testing.assert_array_equal(segments(sampled), exploration().prior_paths)
    assert len(segments(fixed)) == NUM_EPISODES
    assert bar.get_ylabel() == "final direction (°)"
