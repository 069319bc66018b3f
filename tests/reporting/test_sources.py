"""Which runs share a line, and which share a figure."""

import json
from pathlib import Path
from typing import Any

import pytest
from synthetic_runs import adaptation_table, run, write_adaptation, write_run

from maesn.reporting.sources import (
    MANIFEST,
    compare_runs,
    compare_study,
    group_series,
    read_series,
)
from maesn.reporting.style import METHOD_STYLES
from maesn.reporting.tables import summary_tables
from maesn.storage import RunError, write_json


def test_seeds_of_one_experiment_are_one_series() -> None:
    runs = [run(seed=seed, num_threads=seed, checkpoint_every=1 + seed) for seed in range(3)]
    (series,) = group_series(runs)
    assert series.runs == tuple(runs)
    assert (series.name, series.style.label) == ("maesn", "MAESN")
    assert series.style == METHOD_STYLES["maesn"]


def test_methods_come_in_the_order_of_their_runs() -> None:
    runs = [run("maml", iterations=3), run("mine"), run("latent_space"), run("maesn")]
    labels = [series.style.label for series in group_series(runs)]
    assert labels == ["MAML", "mine", "LatentSpace", "MAESN"]


def test_experiments_of_one_method_are_called_by_their_directories() -> None:
    wide = {"context": {"initial_spread": 1.0, "size": 2}}
    runs = [run(learner=wide), run(learner=wide, seed=1), run(episodes_per_task=50, seed=3)]
    series = group_series(runs)
    assert [one.style.label for one in series] == ["MAESN (maesn-0)", "MAESN (maesn-3)"]
    assert [one.name for one in series] == ["maesn", "maesn-2"]
    assert [len(one.runs) for one in series] == [2, 1]
    assert len({(one.style.colour, one.style.line, one.style.marker) for one in series}) == 2


def test_one_seed_given_twice_is_refused() -> None:
    with pytest.raises(RunError, match=r"got seed 0 in both `.*maesn-0` and `.*maesn-0`"):
        group_series([run(), run()])


@pytest.mark.parametrize(
    "other", [{"family": "point"}, {"variant": "paper"}, {"sparse_radius": 1.0}]
)
def test_runs_whose_returns_cannot_be_compared_are_refused(
    tmp_path: Path, other: dict[str, Any]
) -> None:
    runs = [write_run(tmp_path / "a"), write_run(tmp_path / "b", "maml")]
    assert len(read_series(runs)) == 2
    with pytest.raises(RunError, match=f"must have the same `{next(iter(other))}`, got "):
        read_series([*runs, write_run(tmp_path / "c", seed=1, **other)])


@pytest.mark.parametrize(
    ("tasks", "remedy"),
    [("test", "so adapt again"), ("training", "so move one of the files elsewhere")],
)
def test_tables_of_different_tasks_with_one_name_are_refused(
    tmp_path: Path, tasks: str, remedy: str
) -> None:
    runs = [write_run(tmp_path / "a"), write_run(tmp_path / "b", "maml")]
    for directory, digest in zip(runs, ("a1", "b2"), strict=True):
        table = directory / "adaptation" / f"{tasks}-sparse.csv"
        write_adaptation(table, adaptation_table())
        record = table.with_suffix(".settings.json")
        record.write_text(json.dumps({"task_digest": digest}))
    with pytest.raises(RunError, match=rf"a/.*csv` and `.*b/.*different tasks: .*{remedy}"):
        compare_runs(runs)
    record.unlink()
    assert f"{tasks}-sparse" in [one.name for one in compare_runs(runs).comparisons]


def test_seeds_that_were_trained_on_between_two_tables_are_other_policies(tmp_path: Path) -> None:
    runs = [write_run(tmp_path / str(seed), seed=seed) for seed in (0, 1)]
    records = [
        directory / "adaptation" / f"test-sparse{rule}.settings.json"
        for directory in runs
        for rule in ("", "-search-0123abcd")
    ]
    for record in records:
        write_adaptation(record.with_suffix("").with_suffix(".csv"), adaptation_table())
        write_json(record, {"weights": "old"})
    for last, are_same in (("old", True), ("new", False)):
        write_json(records[-1], {"weights": last})
        (comparison,) = compare_runs(runs).comparisons
        gradient, search = comparison.lines
        assert gradient.has_policies_of(search) == are_same


def test_a_study_says_how_its_lines_were_evaluated(tmp_path: Path) -> None:
    write_adaptation(tmp_path / "table.csv", adaptation_table())
    seeds = [{"seed": 0, "table": "table.csv", "training_steps": 7}]
    asked = {"rule": "", "per_update": 10, "deploy": 0, "trained_on": True}
    line = {"name": "maesn", "source": "maesn", "method": "maesn", "label": "MAESN"}
    line |= {"addition": False, "settings": {}, "trial_episodes": None}
    line |= {"evaluation": asked, "seeds": seeds}
    world = {"name": "grid", "family": "grid", "variant": "reference", "sparse_radius": None}
    world |= {"horizon": 15, "tasks": "test", "reward": "sparse", "recorded": {}}
    world |= {"lines": [line], "baselines": [line], "oracle": []}
    write_json(tmp_path / MANIFEST, {"comparisons": [world], "figures": []})
    (comparison,) = compare_study(tmp_path).comparisons
    # The columns of the table are 50 episodes apart.
    assert comparison.lines[0].table.prior_reach.endswith("of the goals in 10 episodes")
    assert "These tasks are the ones that were trained on." in summary_tables(comparison)[0].notes


def test_rules_and_budgets_are_lines_of_the_same_comparison(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run")
    table = run / "adaptation" / "test-sparse.csv"
    for other in ("test-sparse-10-then-trpo-a1b2c3", "test-sparse-with-seed-1", "ood-sparse"):
        table.with_name(f"{other}.csv").write_bytes(table.read_bytes())
    ood, tested = compare_runs([run]).comparisons
    labels = [one.label for one in tested.lines]
    assert labels == ["MAESN", "MAESN (with seed 1)", "MAESN (10 then trpo)"]
    assert [one.published is None for one in tested.lines] == [False, False, True]
    assert tested.lines[0].latents == table.with_suffix(".latents.npz")
    assert {one.recorded for one in tested.lines} == {run / "figures" / "exploration.npz"}
    assert (ood.name, ood.lines[0].recorded) == ("ood-sparse", None)
