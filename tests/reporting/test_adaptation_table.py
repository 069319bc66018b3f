"""Adaptation tables: what is written is read, and what is wrong is said."""

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_runs import NUM_TASKS, NUM_UPDATES, adaptation_table, columns, write_adaptation

from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.running import adaptation_file
from maesn.reporting.reading import (
    COLUMNS,
    DEPLOY,
    EXPLORE,
    MEASURES,
    TableName,
    read_adaptation,
    stack_seeds,
    usual_table,
)
from maesn.reporting.tables import adaptation_tables
from maesn.rules import SearchRule
from maesn.storage import RunError

HEADER = ",".join(COLUMNS)
ROW = "0,0,0,explore,-396.0,-390.0,0.1,0.1,0.02,0"
ONES = "explore,1,1,1,1,1,0"


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "validation-dense.csv"
    written = adaptation_table()
    write_adaptation(path, written)
    header, *rows = path.read_text().splitlines()
    for order in (1, -1):  # the order of the rows does not matter
        path.write_text("\n".join([header, *rows[::order]]))
        table = read_adaptation(path)
        for name in (*MEASURES, "solved_at_reset"):
            np.testing.assert_array_equal(getattr(table, name), getattr(written, name))
    assert (table.tasks, table.reward, table.purpose) == ("validation", "dense", EXPLORE)
    assert table.episodes.tolist() == [0, 50, 100, 150]
    assert table.updates.tolist() == [0, 1, 2, 3]
    assert table.num_tasks == NUM_TASKS


def test_a_deployed_agent_is_judged_and_what_explored_is_remembered(tmp_path: Path) -> None:
    path = tmp_path / "test-sparse.csv"
    explored = adaptation_table()
    deployed = replace(explored, success_rate=np.ones((NUM_TASKS, NUM_UPDATES + 1)))
    write_adaptation(path, explored, deployed)
    table = read_adaptation(path)
    assert table.purpose == DEPLOY
    np.testing.assert_array_equal(table.success_rate, deployed.success_rate)
    np.testing.assert_array_equal(table.explored_success_rate, explored.success_rate)
    # The deployed agent plays no prior episodes.
    assert table.prior_reach == explored.prior_reach
    assert explored.prior_reach not in ("", "100% of the goals in 50 episodes")


@pytest.mark.parametrize(
    ("changed", "name", "label"),
    [
        ({}, "test-sparse", ""),
        ({"episodes": 500, "tasks_at_once": 3, "num_threads": 2}, "test-sparse", ""),
        ({"tasks": "ood", "reward": "dense"}, "ood-dense", ""),
        ({"episodes": 100}, "test-sparse-with-100-episodes", "with 100 episodes"),
        (
            {"episodes": 40, "episodes_per_update": 20, "deploy_episodes": 5, "seed": 3},
            "test-sparse-with-40-episodes-20-per-update-5-deployed-seed-3",
            "with 40 episodes 20 per update 5 deployed seed 3",
        ),
        (
            {"rule": SearchRule(), "episodes": 10, "deploy_after": (0, 10)},
            "test-sparse-search-300275-with-10-episodes-after-0-10",
            "search with 10 episodes after 0 10",
        ),
    ],
)
def test_all_that_decides_the_numbers_is_in_the_name_of_the_file(
    changed: dict[str, Any], name: str, label: str
) -> None:
    file = adaptation_file(Path("run"), Evaluation(**changed))
    assert file == Path(f"run/adaptation/{name}.csv")
    assert TableName.of(file).label == label
    assert TableName.of(file).path(Path("run")) == file


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("file-my-sparse-goals-0a1b2c-dense", ("file-my-sparse-goals-0a1b2c", "dense", "", "")),
        (
            "ood-first-3-sparse-3-full-steps-a0b1c2",
            ("ood-first-3", "sparse", "-3-full-steps-a0b1c2", ""),
        ),
        (
            "test-sparse-cma-with-restarts-a0b1c2",
            ("test", "sparse", "-cma-with-restarts-a0b1c2", ""),
        ),
        ("table", ("table", "", "", "")),
    ],
)
def test_a_name_is_taken_apart(name: str, expected: tuple[str, ...]) -> None:
    assert TableName.of(Path(f"{name}.csv")) == expected


def test_the_usual_table_is_by_the_methods_own_rule_and_the_usual_budget_if_there_is_one(
    tmp_path: Path,
) -> None:
    assert usual_table(tmp_path) is None
    folder = tmp_path / "adaptation"
    for name in ("test-sparse-search-300275", "test-dense", "ood-sparse"):
        write_adaptation(folder / f"{name}.csv", adaptation_table())
    assert usual_table(tmp_path) is None
    for name in ("test-sparse-with-100-episodes", "test-sparse"):
        write_adaptation(folder / f"{name}.csv", adaptation_table())
        assert usual_table(tmp_path) == folder / f"{name}.csv"


def test_a_record_says_how_many_episodes_there_were(tmp_path: Path) -> None:
    """An update of RL2 is one episode; as many are played as there are trials."""
    path = tmp_path / "test-sparse.csv"
    write_adaptation(path, replace(adaptation_table(), episodes=np.arange(NUM_UPDATES + 1)))
    record = {"episodes_per_update": 30, "trial_episodes": 2}
    path.with_suffix(".settings.json").write_text(json.dumps(record))
    table = read_adaptation(path)
    assert table.episodes_per_update == 1
    assert table.prior_reach.endswith("of the goals in 30 episodes")
    assert table.first_beyond == 2
    said = "The method was trained for trials of 2 episodes: from update 2 on it is beyond them."
    assert said in adaptation_tables(path)[0].notes


def test_tasks_that_are_solved_at_reset_are_no_matter_of_exploration() -> None:
    rates = np.zeros((NUM_TASKS, NUM_UPDATES + 1))
    rates[:2, 0] = 0.02, 1.0
    reach = replace(adaptation_table(), explored_success_rate=rates).prior_reach
    assert reach == f"{2 / NUM_TASKS:.0%} of the goals in 50 episodes"
    at_reset = np.zeros_like(rates)
    at_reset[1] = 1.0
    table = replace(adaptation_table(), explored_success_rate=rates, solved_at_reset=at_reset)
    assert np.flatnonzero(table.is_solved_at_reset).tolist() == [1]
    assert table.prior_reach == f"{1 / (NUM_TASKS - 1):.0%} of the goals in 50 episodes"
    rest = table.part(~table.is_solved_at_reset)
    assert (rest.num_tasks, rest.is_solved_at_reset.any()) == (NUM_TASKS - 1, False)
    np.testing.assert_array_equal(rest.mean_return, np.delete(table.mean_return, 1, axis=0))
    everything = replace(table, solved_at_reset=np.ones_like(rates))
    assert everything.prior_reach == ""
    single = columns(adaptation_table(), slice(1))  # the number of episodes is unknown
    assert (single.episodes_per_update, single.prior_reach) == (None, "")


def test_seeds_are_stacked_if_they_have_the_same_tasks() -> None:
    at_reset = np.zeros((NUM_TASKS, NUM_UPDATES + 1))
    at_reset[1, 2] = 0.1
    tables = [adaptation_table(), replace(adaptation_table(seed=1), solved_at_reset=at_reset)]
    stacked = stack_seeds(tables)
    assert stacked.goal_return.shape == (2, NUM_TASKS, NUM_UPDATES + 1)
    np.testing.assert_array_equal(stacked.goal_return[1], tables[1].goal_return)
    # A task is solved at reset if it is so for one seed.
    assert np.flatnonzero(stacked.is_solved_at_reset).tolist() == [1]
    chosen = stacked.part(np.arange(NUM_TASKS) < 2)
    assert (stacked.num_tasks, chosen.num_tasks) == (NUM_TASKS, 2)
    np.testing.assert_array_equal(chosen.goal_return[1], tables[1].goal_return[:2])
    with pytest.raises(RunError, match="got 5 tasks, updates 0 to 3 and 8 tasks"):
        stack_seeds([adaptation_table(), adaptation_table(num_tasks=5)])


@pytest.mark.parametrize(
    "content",
    [
        "",
        "task,update\n0,0\n",
        f"{HEADER}\n",
        f"{HEADER}\n{ROW}\n{ROW}\n",
        f"{HEADER}\n{ROW}\n1,1,50,{ONES}\n",
        f"{HEADER}\n{ROW.replace('-390.0', 'good')}\n",
        f"{HEADER}\n0,0,0,explore,-396.0\n",
        f"{HEADER}\n{ROW.replace('-396.0', 'nan')}\n",
        f"{HEADER}\n{ROW.replace('explore', 'play')}\n",
        # Success is missing in all rows or in none.
        f"{HEADER}\n{ROW}\n1{ROW[1:].replace('0.02', 'nan')}\n",
    ],
)
def test_a_broken_table_is_refused_in_one_sentence(tmp_path: Path, content: str) -> None:
    path = tmp_path / "test-sparse.csv"
    path.write_text(content)
    with pytest.raises(RunError, match=r"cannot be drawn: .*maesn adapt") as caught:
        read_adaptation(path)
    assert "\n" not in str(caught.value)


def test_what_is_no_table_is_refused(tmp_path: Path) -> None:
    binary, pipe = tmp_path / "test-dense.csv", tmp_path / "pipe-sparse.csv"
    binary.write_bytes(b"\xff\xfe\x00")
    os.mkfifo(pipe)  # nobody waits for what will never come
    for path in (tmp_path / "missing.csv", binary, pipe, tmp_path):
        with pytest.raises(RunError, match=r"Expected a table at .*maesn adapt"):
            read_adaptation(path)
