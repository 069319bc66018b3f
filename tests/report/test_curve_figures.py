"""Learning and adaptation curves: what is drawn is the data, with intervals and legends."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from figure_checks import check_saved_whole, crowd, legend, line, note
from matplotlib.figure import Figure
from synthetic_runs import adaptation_table, learning_curve
from synthetic_runs import line as method

from maesn.report.adaptation_table import DEPLOY, Line
from maesn.report.figures.adaptation import plot_adaptation_curves, published_curve
from maesn.report.figures.curves import moving_mean, plot_learning_curves
from maesn.report.statistics import bootstrap, mean
from maesn.report.style import METHOD_STYLES


def learning_figure() -> Figure:
    seeds = (learning_curve(level=-420.0), learning_curve(level=-400.0), learning_curve(20))
    trained = {METHOD_STYLES["maesn"]: seeds, METHOD_STYLES["maml"]: seeds[1:2]}
    return plot_learning_curves(trained, "dense")


def adaptation_figure() -> Figure:
    seeds = (adaptation_table(seed=seed) for seed in range(3))
    lines = [method("maesn", *seeds), method("maml", adaptation_table(gain=5.0))]
    return plot_adaptation_curves(lines, {"maesn": published_curve("wheeled", "maesn")})


def crowded_adaptation_figure() -> Figure:
    tables = (adaptation_table(), adaptation_table(seed=1))
    lines = [
        Line(one.name, one.style, (0, 1)[: 1 + (not i)], tables[: 1 + (not i)])
        for i, one in enumerate(crowd())
    ]
    return plot_adaptation_curves(lines, {})


FIGURES: dict[str, Callable[[], Figure]] = {
    "learning": learning_figure,
    "adaptation": adaptation_figure,
    "crowded adaptation": crowded_adaptation_figure,
}


@pytest.mark.parametrize("make", FIGURES.values(), ids=FIGURES)
def test_every_figure_is_saved_with_nothing_cut_off(
    tmp_path: Path, make: Callable[[], Figure]
) -> None:
    check_saved_whole(make(), tmp_path)


def test_learning_curves() -> None:
    figure = learning_figure()
    before, after, success = figure.axes
    assert before.get_ylabel() == "mean dense return"
    assert {axes.get_xlabel() for axes in figure.axes} == {"meta-iteration"}
    assert before.get_ylim() == after.get_ylim()
    assert success.get_ylim()[0] <= 0.0 < 1.0 <= success.get_ylim()[1]
    assert legend(figure) == ["MAESN, 3 seeds", "MAML"]
    assert "bands: range over the seeds" in note(figure)
    drawn = line(before, "MAESN, 3 seeds")
    # As far as all seeds got; constant curves at -420, -400 and -400.
    assert len(drawn) == 20
    np.testing.assert_allclose(drawn[:, 1], -1220 / 3)
    band = before.collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == (pytest.approx(-420.0), pytest.approx(-400.0))


def test_a_method_without_a_metric_has_no_line_for_it() -> None:
    curve = replace(learning_curve(), return_before=np.full(30, np.nan))
    before, after, _ = plot_learning_curves({METHOD_STYLES["maesn"]: (curve,)}, "sparse").axes
    assert not before.lines
    assert len(after.lines) == 2  # the average, and what it is the average of


def test_moving_mean_is_brute_force() -> None:
    values = np.random.default_rng(0).normal(size=(2, 9))
    expected = [[row[max(0, i - 2) : i + 3].mean() for i in range(9)] for row in values]
    np.testing.assert_allclose(moving_mean(values, 5), expected)
    np.testing.assert_array_equal(moving_mean(values, 1), values)


def test_adaptation_curves() -> None:
    figure = adaptation_figure()
    returns, success, time = figure.axes
    assert returns.get_ylabel() == "mean sparse return"
    assert {axes.get_xlabel() for axes in (returns, success, time)} == {"update"}
    assert [top.get_xlabel() for top in returns.child_axes] == ["episodes learned from"]
    assert legend(figure) == ["MAESN, 3 seeds", "MAML", "MAESN, published"]
    assert note(figure).splitlines() == [
        "bands of MAESN: 95 % interval, resampling 8 tasks and 3 seeds",
        "other bands: 95 % interval, resampling 8 tasks; 1 seed",
        "judged on the episodes that were learned from, z drawn, as in the paper",
    ]
    np.testing.assert_array_equal(line(returns, "MAESN, published")[:, 0], [0, 1, 2, 3])
    assert line(returns, "MAESN, published")[0, 1] == -395.7
    assert not any(one.get_label() == "MAESN, published" for one in success.lines)


def test_the_band_is_the_interval() -> None:
    table = adaptation_table()
    figure = plot_adaptation_curves([method("maesn", table)], {})
    interval = bootstrap(mean, table.mean_return[None, :, -1])
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    at_end = band[band[:, 0] == 3.0, 1]
    assert {at_end.min(), at_end.max()} == {interval.low, interval.high}
    assert line(figure.axes[0], "MAESN")[-1, 1] == pytest.approx(interval.mean)
    assert note(figure).startswith("bands: 95 % interval, resampling 8 tasks; 1 seed\n")


def test_the_note_says_which_lines_judge_the_deployed_agent() -> None:
    fresh = replace(adaptation_table(), purpose=DEPLOY)
    (_, one) = note(plot_adaptation_curves([method("maesn", fresh)], {})).splitlines()
    assert one == "judged on fresh episodes of the deployed agent"
    lines = [method("maesn", fresh), method("maml", adaptation_table())]
    said = note(plot_adaptation_curves(lines, {})).replace("\n", " ")
    assert "MAESN: judged on fresh episodes of the deployed agent; MAML: judged on the" in said


def test_two_numbers_of_episodes_share_no_axis() -> None:
    other = replace(adaptation_table(), episodes=20 * np.arange(4))
    lines = [method("maesn", adaptation_table()), method("maml", other)]
    figure = plot_adaptation_curves(lines, {})
    assert not figure.axes[0].child_axes
    assert "episodes per update: MAESN 50, MAML 20" in note(figure)


def test_methods_are_drawn_in_their_own_style() -> None:
    axes = adaptation_figure().axes[0]
    (drawn,) = (one for one in axes.lines if one.get_label() == "MAML")
    style = METHOD_STYLES["maml"]
    assert (drawn.get_color(), drawn.get_marker()) == (style.colour, style.marker)
