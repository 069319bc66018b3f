"""Learning and adaptation curves: what is drawn is the data, with intervals and legends."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from figure_checks import check_saved_whole, crowd, legend, line
from matplotlib.figure import Figure
from synthetic_runs import adaptation_table, learning_curve, write_metrics, write_run
from synthetic_runs import line as method

from maesn.reporting.comparison import Comparison, Line
from maesn.reporting.figures.curves import (
    learning_charts,
    moving_mean,
    plot_charts,
    plot_curves,
)
from maesn.reporting.published import PublishedCurve, comparable_curve
from maesn.reporting.reading import DEPLOY, stack_seeds
from maesn.reporting.runs import LearningCurve
from maesn.reporting.sources import read_series
from maesn.reporting.statistics import bootstrap, mean


def learning_figure(directory: Path, seeds: Sequence[LearningCurve]) -> Figure:
    """Meta-training of MAESN with three seeds, and of MAML, which is as its second seed."""
    runs = [write_run(directory / f"{i}", seed=i, without=["metrics"]) for i in range(len(seeds))]
    runs.append(write_run(directory / "maml", "maml", without=["metrics"]))
    for run, curve in zip(runs, (*seeds, seeds[1]), strict=True):
        write_metrics(run / "metrics.jsonl", curve)
    (charts,) = learning_charts(read_series(runs)).values()
    return plot_charts(charts)


def curves(*lines: Line) -> Figure:
    return plot_curves(Comparison(lines, family="wheeled"))


def adaptation_figure() -> Figure:
    seeds = (adaptation_table(seed=seed) for seed in range(3))
    lines = [method("maesn", *seeds), method("maml_bias_only", adaptation_table(gain=5.0))]
    protocol = ("wheeled", "reference", None)
    published = [comparable_curve(*protocol, one.name, one.table) for one in lines]
    return curves(*map(_with_published, lines, published))


def _with_published(line: Line, curve: PublishedCurve | None) -> Line:
    return replace(line, published=curve)


def crowded_adaptation_figure() -> Figure:
    tables = (adaptation_table(), adaptation_table(seed=1))
    lines = [
        Line(one.name, one.style, (0, 1)[: 1 + (not i)], stack_seeds(tables[: 1 + (not i)]))
        for i, one in enumerate(crowd())
    ]
    return curves(*lines)


@pytest.mark.parametrize("make", [adaptation_figure, crowded_adaptation_figure])
def test_every_figure_is_saved_with_nothing_cut_off(
    tmp_path: Path, make: Callable[[], Figure]
) -> None:
    check_saved_whole(make(), tmp_path)


def test_learning_curves(tmp_path: Path) -> None:
    seeds = learning_curve(level=-420.0), learning_curve(level=-400.0), learning_curve(20)
    figure = learning_figure(tmp_path, seeds)
    success, before, after = figure.axes
    assert before.get_ylabel() == "mean dense return"
    assert {axes.get_xlabel() for axes in figure.axes} == {"meta-iteration"}
    assert before.get_ylim() == after.get_ylim()
    assert success.get_ylim()[0] <= 0.0 < 1.0 <= success.get_ylim()[1]
    assert legend(figure) == ["MAESN, 3 seeds", "MAML"]
    drawn = line(before, "MAESN, 3 seeds")
    # As far as all seeds got; constant curves at -420, -400 and -400.
    assert len(drawn) == 20
    np.testing.assert_allclose(drawn[:, 1], -1220 / 3)
    band = before.collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == (pytest.approx(-420.0), pytest.approx(-400.0))
    check_saved_whole(figure, tmp_path)


def test_a_number_that_no_run_has_is_no_panel(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", without=["metrics"])
    no_success = replace(learning_curve(), success_after=np.full(30, np.nan))
    write_metrics(run / "metrics.jsonl", no_success)
    (charts,) = learning_charts(read_series([run])).values()
    assert [chart.y for chart in charts] == ["mean dense return"] * 2


def test_moving_mean_is_brute_force() -> None:
    values = np.random.default_rng(0).normal(size=(2, 9))
    expected = [[row[max(0, i - 2) : i + 3].mean() for i in range(9)] for row in values]
    np.testing.assert_allclose(moving_mean(values, 5), expected)
    np.testing.assert_array_equal(moving_mean(values, 1), values)


def test_adaptation_curves() -> None:
    figure = adaptation_figure()
    returns, success = figure.axes
    assert returns.get_ylabel() == "mean sparse return"
    assert {axes.get_xlabel() for axes in figure.axes} == {"episodes in the new task"}
    assert legend(figure) == ["MAESN, 3 seeds", "MAML (bias only)"]
    published, other = (
        one for one in returns.lines if one.get_marker() == "o" and one.get_linestyle() == "None"
    )
    assert np.asarray(other.get_ydata())[0] == -404.8  # of MAML
    np.testing.assert_array_equal(published.get_xdata(), [0, 50, 100, 150])
    assert np.asarray(published.get_ydata())[0] == -395.7
    assert len(success.lines) == 2


def test_the_band_is_the_interval() -> None:
    table = adaptation_table()
    figure = curves(method("maesn", table))
    interval = bootstrap(mean, table.mean_return[None, :, -1])
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    at_end = band[band[:, 0] == 150.0, 1]
    assert {at_end.min(), at_end.max()} == {interval.low, interval.high}
    assert line(figure.axes[0], "MAESN")[-1, 1] == pytest.approx(interval.mean)


def test_the_figure_marks_baseline_and_oracle(tmp_path: Path) -> None:
    fresh = replace(adaptation_table(), purpose=DEPLOY)
    memory = replace(adaptation_table(5), episodes=np.arange(4), trial_episodes=2)
    compared = Comparison(
        (method("maesn", fresh), method("rl2", memory)),
        baselines=(method("idle", replace(fresh, mean_return=0 * fresh.mean_return - 400)),),
        oracle=(method("oracle", replace(fresh, mean_return=0 * fresh.mean_return - 300)),),
    )
    figure = plot_curves(compared)
    returns, success = figure.axes
    # Two lengths of updates share a logarithmic axis.
    assert returns.get_xscale() == success.get_xscale() == "symlog"
    shown = line(returns, "MAESN")
    np.testing.assert_array_equal(shown[:, 0], 50 * np.arange(4))
    np.testing.assert_allclose(shown[:, 1], fresh.mean_return.mean(0))
    assert line(returns, "baseline")[:, 1].tolist() == [-400.0, -400.0]
    assert line(returns, "oracle")[:, 1].tolist() == [-300.0, -300.0]
    assert legend(figure) == ["MAESN", "RL²", "baseline", "oracle"]
    check_saved_whole(figure, tmp_path)
