"""Adaptation tables: what is written is read, and what is wrong is said."""

import json
import os
from dataclasses import replace
from pathlib import Path

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
    table_name,
)
from maesn.reporting.tables import update_tables
from maesn.storage import RunError

HEADER = ",".join(COLUMNS)
ROW = "0,0,0,explore,-396.0,-390.0,0.1,0.1,0.02,0"
ONES = "explore,1,1,1,1,1,0"


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "validation-dense.csv"
    written = adaptation_table()
    write_adaptation(path, written)
    table = read_adaptation(path)
    for name in MEASURES:
        np.testing.assert_array_equal(getattr(table, name), getattr(written, name))
    np.testing.assert_array_equal(table.solved_at_reset, written.solved_at_reset)
    assert (table.tasks, table.reward, table.purpose) == ("validation", "dense", EXPLORE)
    assert table.episodes.tolist() == [0, 50, 100, 150]
    assert table.updates.tolist() == [0, 1, 2, 3]
    assert table.num_tasks == NUM_TASKS


def test_the_order_of_the_rows_does_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "my-goals-sparse.csv"
    write_adaptation(path, adaptation_table())
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *rows[::-1]]))
    table = read_adaptation(path)
    np.testing.assert_array_equal(table.mean_return, adaptation_table().mean_return)
    assert (table.tasks, table.reward) == ("my-goals", "sparse")


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


def test_an_adaptation_that_continued_another_starts_later(tmp_path: Path) -> None:
    path = tmp_path / "test-sparse.csv"
    written = adaptation_table()
    later = replace(written, updates=written.updates + 10, episodes=written.episodes + 500)
    write_adaptation(path, later)
    table = read_adaptation(path)
    assert table.updates.tolist() == [10, 11, 12, 13]
    assert table.episodes_per_update == 50
    # Its first column is not played from the prior.
    assert table.prior_reach == ""


def test_the_path_of_a_table_says_what_its_name_says() -> None:
    usual = adaptation_file(Path("run"), Evaluation())
    assert usual == Path("run/adaptation/test-sparse.csv")
    assert table_name(usual) == TableName("test", "sparse")
    changed = Evaluation(tasks="ood", reward="dense", engine="mjx")
    other = adaptation_file(Path("run"), changed)
    assert table_name(other) == TableName("ood-on-mjx", "dense")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("test-sparse", ("test", "sparse", "")),
        ("from-10-test-dense", ("from-10-test", "dense", "")),
        ("file-my-sparse-goals-0a1b2c-dense", ("file-my-sparse-goals-0a1b2c", "dense", "")),
        ("test-sparse-10-then-trpo", ("test", "sparse", "-10-then-trpo")),
        ("ood-on-mjx-sparse-3-full-steps", ("ood-on-mjx", "sparse", "-3-full-steps")),
        ("validation-dense-bonus-vime", ("validation", "dense", "-bonus-vime")),
        ("table", ("table", "", "")),
    ],
)
def test_a_name_says_of_what_a_table_is(name: str, expected: tuple[str, str, str]) -> None:
    assert table_name(Path(f"{name}.csv")) == expected


def test_a_record_says_how_many_episodes_there_were(tmp_path: Path) -> None:
    """Of RL2, an update is one episode, of which as many are played as there are trials."""
    path = tmp_path / "test-sparse.csv"
    write_adaptation(path, replace(adaptation_table(), episodes=np.arange(NUM_UPDATES + 1)))
    record = {"episodes_per_update": 30, "trial_episodes": 2}
    path.with_suffix(".settings.json").write_text(json.dumps(record))
    table = read_adaptation(path)
    assert table.episodes_per_update == 1
    assert table.prior_reach.endswith("of the goals in 30 episodes")
    assert table.first_beyond == 2
    (summary,) = update_tables(table, "RL2")
    assert summary.notes[0] == (
        "The method was trained for trials of 2 episodes: from update 2 on it is beyond them."
    )


def test_a_goal_counts_as_reached_if_one_episode_reaches_it() -> None:
    rates = np.zeros((NUM_TASKS, NUM_UPDATES + 1))
    rates[:2, 0] = 0.02, 1.0
    rates[:, 1] = 1.0
    reach = replace(adaptation_table(), explored_success_rate=rates).prior_reach
    assert reach == f"{2 / NUM_TASKS:.0%} of the goals in 50 episodes"


def test_tasks_that_are_solved_at_reset_are_no_matter_of_exploration() -> None:
    rates = np.zeros((NUM_TASKS, NUM_UPDATES + 1))
    rates[:2, 0] = 0.02, 1.0
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


def test_without_an_update_the_number_of_episodes_is_unknown() -> None:
    single = columns(adaptation_table(), slice(1))
    assert single.episodes_per_update is None
    assert single.prior_reach == ""


def test_seeds_are_stacked() -> None:
    tables = [adaptation_table(seed=seed) for seed in range(3)]
    stacked = stack_seeds(tables)
    assert stacked.goal_return.shape == (3, NUM_TASKS, NUM_UPDATES + 1)
    np.testing.assert_array_equal(stacked.goal_return[2], tables[2].goal_return)
    assert stacked.num_tasks == NUM_TASKS
    chosen = stacked.part(np.arange(NUM_TASKS) < 2)
    np.testing.assert_array_equal(chosen.goal_return[2], tables[2].goal_return[:2])


def test_a_task_is_solved_at_reset_if_it_is_so_for_one_seed() -> None:
    at_reset = np.zeros((NUM_TASKS, NUM_UPDATES + 1))
    at_reset[1, 2] = 0.1
    other = replace(adaptation_table(), solved_at_reset=at_reset)
    stacked = stack_seeds([adaptation_table(), other])
    assert np.flatnonzero(stacked.is_solved_at_reset).tolist() == [1]


def test_seeds_with_different_tasks_are_refused() -> None:
    with pytest.raises(
        RunError,
        match=r"got 5 tasks, updates 0 to 3 and 8 tasks, updates 0 to 3.*same `--tasks`",
    ):
        stack_seeds([adaptation_table(), adaptation_table(num_tasks=5)])


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("", "its rows of purpose explore lack a task or an update, or repeat one"),
        ("task,update\n0,0\n", "cannot be drawn: 'purpose'"),
        (f"{HEADER}\n", "its rows of purpose explore lack a task or an update, or repeat one"),
        (
            f"{HEADER}\n{ROW}\n{ROW}\n",
            "its rows of purpose explore lack a task or an update, or repeat one",
        ),
        (
            f"{HEADER}\n{ROW}\n1,1,50,{ONES}\n",
            "its rows of purpose explore lack a task or an update, or repeat one",
        ),
        (
            f"{HEADER}\n{ROW.replace('-390.0', 'good')}\n",
            "cannot be drawn: could not convert string to float: .*good",
        ),
        (
            f"{HEADER}\n0,0,0,explore,-396.0\n",
            "a number in it is not finite",
        ),
        (
            f"{HEADER}\n{ROW.replace('-396.0', 'nan')}\n",
            "a number in it is not finite",
        ),
        (
            f"{HEADER}\n{ROW.replace('explore', 'play')}\n",
            "its rows of purpose explore lack a task or an update, or repeat one",
        ),
    ],
)
def test_a_broken_table_is_refused_in_one_sentence(
    tmp_path: Path, content: str, complaint: str
) -> None:
    path = tmp_path / "test-sparse.csv"
    path.write_text(content)
    with pytest.raises(RunError, match=complaint) as caught:
        read_adaptation(path)
    assert "maesn adapt" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_or_unreadable_table_is_refused(tmp_path: Path) -> None:
    missing, binary = tmp_path / "test-sparse.csv", tmp_path / "test-dense.csv"
    binary.write_bytes(b"\xff\xfe\x00")
    for path in (missing, binary, tmp_path):
        with pytest.raises(RunError, match=r"Expected a table at .*maesn adapt"):
            read_adaptation(path)


def test_a_pipe_is_refused_instead_of_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "test-sparse.csv")
    with pytest.raises(RunError, match="it is a pipe or a device"):
        read_adaptation(tmp_path / "test-sparse.csv")
