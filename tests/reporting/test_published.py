"""The published curves, against numbers read off the table's source by eye."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_runs import adaptation_table

from maesn.reporting.published import PublishedCurve, comparable_curve


def published_curve(family: str, method: str) -> PublishedCurve | None:
    """What the paper shows for a run with its protocol."""
    episodes = (20 if family == "blockpush" else 50) * np.arange(4)
    table = replace(adaptation_table(), episodes=episodes)
    return comparable_curve(family, "reference", None, method, table)


@pytest.mark.parametrize(
    ("family", "method", "start", "end"),
    [
        ("wheeled", "maesn", -395.7, -357.5),
        ("wheeled", "latent_space", -400.8, -396.8),
        ("wheeled", "maml_bias_only", -404.8, -411.4),
        ("ant", "maesn", 309.3, 374.9),
        ("ant", "rl2", 291.0, 290.7),
        ("blockpush", "maesn", -376.7, -278.6),
        ("blockpush", "trpo", -439.3, -305.4),
        ("blockpush", "reinforce", -439.3, -422.3),
    ],
)
def test_ends_of_the_curves(family: str, method: str, start: float, end: float) -> None:
    curve = published_curve(family, method)
    assert curve is not None
    assert (curve.mean_return[0], curve.mean_return[-1]) == (start, end)
    assert (curve.update[0], curve.update[-1]) == (0, 99)


def test_only_the_same_protocol_is_comparable() -> None:
    table = adaptation_table()
    per_twenty = replace(table, episodes=20 * np.arange(4))
    curve = comparable_curve("wheeled", "reference", None, "maesn", table)
    assert curve is not None
    assert comparable_curve("wheeled", "reference", 0.8, "maesn", table)
    assert comparable_curve(
        "wheeled", "reference", 0.8, "maesn", replace(table, tasks="test-first-9")
    )
    assert comparable_curve("blockpush", "reference", None, "maesn", per_twenty)
    assert comparable_curve("wheeled", "reference", 1.0, "maesn", table) is None
    assert comparable_curve("wheeled", "paper", None, "maesn", table) is None
    assert comparable_curve("point", "reference", None, "maesn", table) is None
    assert comparable_curve("wheeled", "reference", None, "mine", table) is None
    assert comparable_curve("wheeled", "reference", None, "maml", table) is None
    elsewhere = (
        replace(table, tasks=tasks)
        for tasks in ("ood", "test-radius-1.0", "file-x-a1b2c3", "my/goals")
    )
    for other in (replace(table, reward="dense"), per_twenty, *elsewhere):
        assert comparable_curve("wheeled", "reference", None, "maesn", other) is None
