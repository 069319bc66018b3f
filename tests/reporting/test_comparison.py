"""Comparisons: the score, the tidy table, the summary and the figure, from synthetic curves."""

import csv
import dataclasses
from pathlib import Path

import numpy as np
from synthetic_runs import NUM_UPDATES, adaptation_table, columns
from synthetic_runs import line as named

from maesn.reporting.comparison import Comparison, Line, tidy_rows
from maesn.reporting.reading import AdaptationTable
from maesn.reporting.tables import TextTable, summary_tables
from maesn.storage import write_rows

HORIZON = 20


def constant(value: float, num_tasks: int = 8) -> AdaptationTable:
    return dataclasses.replace(
        columns(adaptation_table(num_tasks), slice(1)),
        mean_return=np.full((num_tasks, 1), value),
    )


def comparison(*lines: Line, oracle: float | None = -300.0) -> Comparison:
    return Comparison(
        lines=lines or (named("maesn", adaptation_table()),),
        horizon=HORIZON,
        baselines=(named("idle", constant(-400.0)), named("random", constant(-420.0))),
        oracle=() if oracle is None else (named("oracle", constant(oracle)),),
    )


def cells(table: TextTable, heading: str) -> list[str]:
    """A column of a table."""
    return [row[table.headings.index(heading)] for row in table.rows]


def test_evaluations_of_the_same_policies_are_paired_by_seed() -> None:
    tables = [adaptation_table(seed=seed) for seed in range(3)]
    twice = dataclasses.replace(named("maesn", *tables), source="maesn")
    apart = dataclasses.replace(twice, source="maml")
    for other, is_even in ((twice, True), (apart, False)):
        probability = cells(summary_tables(comparison(twice, other))[-1], "probability")
        assert (probability == ["0.50 [0.50, 0.50]"]) == is_even


def test_the_score_is_linear_between_the_better_baseline_and_the_oracle_and_beyond() -> None:
    returns = np.array([-400.0, -350.0, -300.0, -450.0, -200.0])
    np.testing.assert_allclose(comparison().score(returns, 8), [0.0, 0.5, 1.0, -0.5, 2.0])


def test_baseline_and_oracle_are_means_over_the_tasks_that_are_scored() -> None:
    uneven = dataclasses.replace(
        constant(0.0), mean_return=np.array([[-300.0]] * 4 + [[-100.0]] * 4)
    )
    compared = dataclasses.replace(comparison(), oracle=(named("oracle", uneven),))
    assert compared.references(8) == {"baseline": -400.0, "oracle": -200.0}
    assert compared.references(4) == {"baseline": -400.0, "oracle": -300.0}


def test_without_an_oracle_above_the_baseline_there_is_no_score_and_it_is_said_why() -> None:
    for oracle, why in ((None, "--oracle DIR"), (-400.0, "oracle above the baseline")):
        compared = comparison(oracle=oracle)
        assert np.isnan(compared.score(np.zeros(3), 8)).all()
        assert {row["score"] for row in tidy_rows(compared)} == {""}
        assert why in summary_tables(compared)[0].to_markdown()
    assert "no score" not in summary_tables(comparison())[0].to_markdown()


def test_some_methods_may_have_a_score_where_others_have_none() -> None:
    # On the first four tasks the oracle is no better than the baseline.
    uneven = dataclasses.replace(
        constant(0.0), mean_return=np.array([[-400.0]] * 4 + [[-100.0]] * 4)
    )
    lines = named("maesn", adaptation_table()), named("vime", adaptation_table(4))
    compared = dataclasses.replace(comparison(*lines), oracle=(named("oracle", uneven),))
    everything, first, *_ = summary_tables(compared)
    assert [*map(bool, cells(everything, "score")[:2])] == [True, False]
    assert [*map(bool, cells(first, "score")[:2])] == [False, False]
    assert all("no score" in table.to_markdown() for table in (everything, first))
    scores = {row["method"] for row in tidy_rows(compared) if row["score"] == ""}
    assert scores == {"vime"}


def test_the_tidy_table_has_one_row_per_method_seed_task_and_update(tmp_path: Path) -> None:
    tables = [adaptation_table(seed=seed) for seed in range(2)]
    compared = comparison(named("maesn", *tables), named("trpo", adaptation_table(5)))
    write_rows(tmp_path / "table.csv", tidy_rows(compared))
    with (tmp_path / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert ",".join(rows[0]) == (
        "method,seed,task,update,purpose,protocol,steps,mean_return,goal_return,success_rate,"
        "score,solved_at_reset"
    )
    # Baselines and oracle are played once, at the start.
    assert len(rows) == (2 * 8 + 5) * (NUM_UPDATES + 1) + 3 * 8
    keys = {(row["method"], row["seed"], row["task"], row["update"]) for row in rows}
    assert len(keys) == len(rows)
    (row,) = (row for row in rows if [*row.values()][:4] == ["maesn", "1", "3", "2"])
    assert int(row["steps"]) == 2 * 50 * HORIZON
    # The table has the digits of single precision.
    assert np.float32(row["mean_return"]) == np.float32(tables[1].mean_return[3, 2])
    assert np.float32(row["success_rate"]) == np.float32(tables[1].success_rate[3, 2])
    score = (tables[1].mean_return[3, 2] + 400) / 100
    np.testing.assert_allclose(float(row["score"]), score, rtol=1e-6)


def test_pairs_are_compared_on_the_tasks_that_both_have() -> None:
    long, short = adaptation_table(), adaptation_table(5, seed=1)
    *_, beats = summary_tables(comparison(named("maesn", long), named("vime", short)))
    wins = np.mean(long.mean_return[:5, -1] > short.mean_return[:, -1])
    assert 0 < wins < 1
    assert beats.rows[0][:2] == ("MAESN", "VIME")
    assert beats.rows[0][2].startswith(f"{wins:.2f} [")


def test_each_method_has_a_row_by_episodes() -> None:
    table = adaptation_table()
    searched = dataclasses.replace(table, episodes=np.arange(NUM_UPDATES + 1))
    _, returns, success, _ = summary_tables(
        comparison(named("maesn", table), named("rl2", searched))
    )
    assert returns.headings == ("method", "0", "1", "2", "3", "50", "100")
    (_, start, *none, fifty, hundred), (_, *few, _, _) = returns.rows
    assert none == ["", "", ""]
    assert few[0] == start
    for text, column in ((start, 0), (fifty, 1), (hundred, 2), (few[2], 2)):
        assert text.startswith(f"{table.mean_return[:, column].mean():.1f} ±")
    assert success.rows[0][1].startswith(f"{100 * table.success_rate[:, 0].mean():.1f} ±")


def test_where_a_method_has_fewer_tasks_all_are_shown_in_these_as_well() -> None:
    trained = dataclasses.replace(named("maesn", adaptation_table()), training_steps=48_000_000)
    everything, common, *_ = summary_tables(comparison(trained, named("vime", adaptation_table(5))))
    assert cells(everything, "tasks")[:2] == ["8", "5"]
    assert cells(common, "tasks") == ["5"] * 5
    assert common.title == f"{everything.title}, the first 5 alone"
    mean = adaptation_table().mean_return[:5, -1].mean()
    assert cells(common, "return")[0].startswith(f"{mean:.1f} [")
    assert common.rows[1] == everything.rows[1]
    assert cells(everything, "trained on") == ["48 M", "", "", "", ""]
    # Also where baselines and oracle alone have more of them.
    assert len(summary_tables(comparison(named("vime", adaptation_table(5))))) == 4
    alike = comparison(trained, named("trpo", adaptation_table()))
    assert len(summary_tables(alike)) == 4


def with_solved(solved: list[int], line: Line) -> Line:
    """The same line, where all episodes of some tasks start in the goal region."""
    at_reset = np.zeros(line.table.mean_return.shape)
    at_reset[:, [task for task in solved if task < line.num_tasks]] = 1.0
    return dataclasses.replace(
        line, table=dataclasses.replace(line.table, solved_at_reset=at_reset)
    )


def test_tasks_solved_at_reset_are_marked_and_left_out_of_a_second_table(tmp_path: Path) -> None:
    some = comparison(named("maesn", adaptation_table()), named("trpo", adaptation_table(5)))
    compared = dataclasses.replace(
        some,
        lines=tuple(with_solved([1, 6], line) for line in some.lines),
        baselines=tuple(with_solved([1, 6], line) for line in some.baselines),
    )
    write_rows(tmp_path / "table.csv", tidy_rows(compared))
    with (tmp_path / "table.csv").open(newline="") as file:
        marked = {row["task"] for row in csv.DictReader(file) if int(row["solved_at_reset"])}
    assert marked == {"1", "6"}
    everything, _, others, *_ = summary_tables(compared)
    assert "2 of the 8 tasks are solved at reset." in everything.notes
    assert others.title == f"{everything.title}, without tasks solved at reset"
    rest = np.delete(adaptation_table().mean_return[:, -1], [1, 6])
    assert cells(others, "tasks")[:2] == ["6", "4"]
    assert cells(others, "return")[0].startswith(f"{rest.mean():.1f} [")
    # A method without any of these tasks drops out, and if all do, so does the table.
    alone = with_solved([0], named("vime", adaptation_table(1)))
    baselines = tuple(with_solved([0], line) for line in some.baselines)
    compared = dataclasses.replace(some, lines=(alone, *some.lines[:1]), baselines=baselines)
    assert cells(summary_tables(compared)[2], "method")[0] == "MAESN"
    nobody = dataclasses.replace(compared, lines=(alone,))
    assert not any("solved at reset" in table.title for table in summary_tables(nobody))
