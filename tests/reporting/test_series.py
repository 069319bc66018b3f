"""Which runs share a line, and which share a figure."""

from typing import Any

import pytest
from synthetic_runs import run

from maesn.reporting.series import check_world, group_series
from maesn.reporting.style import METHOD_STYLES
from maesn.storage import RunError


def test_seeds_of_one_experiment_are_one_series() -> None:
    runs = [run(seed=seed, num_threads=seed, checkpoint_every=1 + seed) for seed in range(3)]
    (series,) = group_series(runs)
    assert series.runs == tuple(runs)
    assert (series.name, series.label) == ("maesn", "MAESN")
    assert series.style == METHOD_STYLES["maesn"]


def test_methods_come_in_the_order_of_their_styles() -> None:
    runs = [run("maml"), run("mine"), run("latent_space"), run("maesn")]
    labels = [series.label for series in group_series(runs)]
    assert labels == ["MAESN", "LatentSpace", "MAML", "mine"]


def test_experiments_of_one_method_are_told_apart_by_what_differs() -> None:
    wide = {"context": {"initial_spread": 1.0, "size": 2}}
    narrow = {"context": {"initial_spread": 0.0, "size": 2}}
    runs = [
        run(learner=wide, episodes_per_task=20),
        run(learner=wide, episodes_per_task=50),
        run(learner=narrow, episodes_per_task=20),
    ]
    series = group_series(runs)
    assert [one.label for one in series] == [
        "MAESN (episodes per task 20, initial spread 1.0)",
        "MAESN (episodes per task 50, initial spread 1.0)",
        "MAESN (episodes per task 20, initial spread 0.0)",
    ]
    assert [one.name for one in series] == ["maesn", "maesn-2", "maesn-3"]
    assert len({(one.style.colour, one.style.line, one.style.marker) for one in series}) == 3


def test_a_difference_between_methods_is_no_part_of_the_label() -> None:
    first, second = group_series([run("maesn", iterations=300), run("maml", iterations=500)])
    assert (first.label, second.label) == ("MAESN", "MAML")


def test_one_seed_given_twice_is_refused() -> None:
    with pytest.raises(RunError, match=r"got seed 0 in both `.*maesn-0` and `.*maesn-0`"):
        group_series([run(), run()])


@pytest.mark.parametrize(
    "other", [{"family": "point"}, {"variant": "paper"}, {"sparse_radius": 1.0}, {"engine": "mjx"}]
)
def test_runs_whose_returns_cannot_be_compared_are_refused(other: dict[str, Any]) -> None:
    check_world([run(), run("maml")])
    with pytest.raises(RunError, match=f"must have the same `{next(iter(other))}`, got "):
        check_world([run(), run(**other)])
