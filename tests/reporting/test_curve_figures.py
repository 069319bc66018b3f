"""Learning and adaptation curves: what is drawn is the data, with intervals and legends."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from figure_checks import check_saved_whole, crowd, labels, line
from synthetic_runs import adaptation_table, learning_curve
from synthetic_runs import line as method

from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.figures.curves import moving_mean, plot_curves, plot_learning_curves
from maesn.reporting.published import PublishedCurve, comparable_curve
from maesn.reporting.reading import DEPLOY, stack_seeds
from maesn.reporting.statistics import INTERVAL, bootstrap, mean
from maesn.reporting.style import METHOD_STYLES, Drawn


def learning_figure() -> Drawn:
    seeds = (learning_curve(level=-420.0), learning_curve(level=-400.0), learning_curve(20))
    trained = {METHOD_STYLES["maesn"]: seeds, METHOD_STYLES["maml"]: seeds[1:2]}
    return plot_learning_curves(trained, "dense")


def curves(*lines: Line) -> Drawn:
    return plot_curves(Comparison(lines, family="wheeled"))


def adaptation_figure() -> Drawn:
    seeds = (adaptation_table(seed=seed) for seed in range(3))
    lines = [method("maesn", *seeds), method("maml_bias_only", adaptation_table(gain=5.0))]
    protocol = ("wheeled", "reference", None)
    published = [comparable_curve(*protocol, one.name, one.table) for one in lines]
    return curves(*map(_with_published, lines, published))


def _with_published(line: Line, curve: PublishedCurve | None) -> Line:
    return replace(line, published=curve)


def crowded_adaptation_figure() -> Drawn:
    tables = (adaptation_table(), adaptation_table(seed=1))
    lines = [
        Line(one.name, one.style, (0, 1)[: 1 + (not i)], stack_seeds(tables[: 1 + (not i)]))
        for i, one in enumerate(crowd())
    ]
    return curves(*lines)


FIGURES: dict[str, Callable[[], Drawn]] = {
    "learning": learning_figure,
    "adaptation": adaptation_figure,
    "crowded adaptation": crowded_adaptation_figure,
}


@pytest.mark.parametrize("make", FIGURES.values(), ids=FIGURES)
def test_every_figure_is_saved_with_nothing_cut_off(
    tmp_path: Path, make: Callable[[], Drawn]
) -> None:
    check_saved_whole(make(), tmp_path)


def test_learning_curves() -> None:
    figure, notes = learning_figure()
    success, before, after = figure.axes
    assert before.get_ylabel() == "mean dense return"
    assert {axes.get_xlabel() for axes in figure.axes} == {"meta-iteration"}
    assert before.get_ylim() == after.get_ylim()
    assert success.get_ylim()[0] <= 0.0 < 1.0 <= success.get_ylim()[1]
    assert labels(after) == ["MAESN, 3 seeds", "MAML"]
    assert "bands: range over the seeds; thin: iterations of a single seed" in notes
    drawn = line(before, "MAESN, 3 seeds")
    # As far as all seeds got; constant curves at -420, -400 and -400.
    assert len(drawn) == 20
    np.testing.assert_allclose(drawn[:, 1], -1220 / 3)
    band = before.collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == (pytest.approx(-420.0), pytest.approx(-400.0))


def test_a_method_without_a_metric_has_no_line_for_it() -> None:
    curve = replace(learning_curve(), return_before=np.full(30, np.nan))
    drawn = plot_learning_curves({METHOD_STYLES["maesn"]: (curve,)}, "sparse")
    _, before, after = drawn.figure.axes
    assert all(np.isnan(np.asarray(one.get_ydata(), float)).all() for one in before.lines)
    assert len(after.lines) == 2  # the average, and what it is the average of


def test_moving_mean_is_brute_force() -> None:
    values = np.random.default_rng(0).normal(size=(2, 9))
    expected = [[row[max(0, i - 2) : i + 3].mean() for i in range(9)] for row in values]
    np.testing.assert_allclose(moving_mean(values, 5), expected)
    np.testing.assert_array_equal(moving_mean(values, 1), values)


def test_adaptation_curves() -> None:
    figure, notes = adaptation_figure()
    returns, success = figure.axes
    assert returns.get_ylabel() == "mean sparse return"
    assert {axes.get_xlabel() for axes in figure.axes} == {"episodes in the new task"}
    assert labels(returns) == ["MAML (bias only)", "MAESN, 3 seeds"]
    bands, judged = notes
    assert bands.startswith(f"bands: {INTERVAL}; circles: as")
    assert judged == "judged on the episodes that were learned from, z drawn, as in the paper"
    published, other = (
        one for one in returns.lines if one.get_marker() == "o" and one.get_linestyle() == "None"
    )
    assert np.asarray(other.get_ydata())[0] == -404.8  # of MAML
    np.testing.assert_array_equal(published.get_xdata(), [0, 50, 100, 150])
    assert np.asarray(published.get_ydata())[0] == -395.7
    assert len(success.lines) == 2


def test_the_band_is_the_interval() -> None:
    table = adaptation_table()
    figure = curves(method("maesn", table)).figure
    interval = bootstrap(mean, table.mean_return[None, :, -1])
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    at_end = band[band[:, 0] == 150.0, 1]
    assert {at_end.min(), at_end.max()} == {interval.low, interval.high}
    assert line(figure.axes[0], "MAESN")[-1, 1] == pytest.approx(interval.mean)


def test_the_note_says_which_lines_judge_the_deployed_agent() -> None:
    fresh = replace(adaptation_table(), purpose=DEPLOY)
    (_, one) = curves(method("maesn", fresh)).notes
    assert one == "judged on fresh episodes of the deployed agent"
    lines = [method("maesn", fresh), method("maml", adaptation_table())]
    *_, said = curves(*lines).notes
    assert said.startswith("judged on fresh episodes of the deployed agent (MAESN); or judged on")
    assert said.endswith("(MAML)")


def test_two_lengths_of_updates_share_a_logarithmic_axis() -> None:
    other = replace(adaptation_table(), episodes=20 * np.arange(4))
    lines = [method("maesn", adaptation_table()), method("maml", other)]
    assert {one.get_xscale() for one in curves(*lines).figure.axes} == {"symlog"}


def test_methods_are_drawn_in_their_own_style() -> None:
    axes = adaptation_figure().figure.axes[0]
    (drawn,) = (one for one in axes.lines if one.get_label() == "MAML (bias only)")
    style = METHOD_STYLES["maml_bias_only"]
    assert (drawn.get_color(), drawn.get_marker()) == (style.colour, style.marker)
