"""What is possible in families whose best behaviour can be computed: how it is told.

`limits_grid_navi.py` and `limits_sparse_point.py` compute it. A trial is some episodes in one task.
The *oracle* knows the task. The *searcher* knows only the family's distribution and what it has
seen in the trial.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Returns = Float[np.ndarray, " episode"]


class Limits(NamedTuple):
    """Mean returns over tasks."""

    oracle: float
    """Of an episode."""
    below: Returns
    """What a searcher reaches in each episode of a trial."""
    above: Returns
    """What none exceeds: `below` again, if that is exact."""


def print_table(found: Mapping[str, Limits]) -> None:
    """Print the first three episodes, the last one and the mean of the trial, for each family."""
    print("| family | return of an episode | first | second | third | last | mean of the trial |")
    print("|---|---|---|---|---|---|---|")
    for name, limits in found.items():
        for what, returns in _rows(limits).items():
            shown = " | ".join(f"{x:.2f}" for x in (*returns[:3], returns[-1], returns.mean()))
            print(f"| {name} | {what} | {shown} |")


def _rows(limits: Limits) -> dict[str, Returns]:
    oracle = {"oracle": np.full(len(limits.below), limits.oracle)}
    if np.array_equal(limits.below, limits.above):
        return oracle | {"best searcher, exact": limits.below}
    return oracle | {"best sweep": limits.below, "no searcher exceeds": limits.above}
