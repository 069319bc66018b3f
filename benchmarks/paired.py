"""By how much one adaptation is better than another in the same tasks, task by task.

    python benchmarks/paired.py results/searches/tables/blockpush blockpush-search blockpush-before

The arguments are a directory of tables and the names of two lines of a study, or two tables of
`maesn adapt`. For every number of episodes that both have, it prints the mean difference of the
returns, with half its 95 % interval over tasks (1.96 standard errors), and the number of tasks.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from maesn.reporting.reading import AdaptationTable, read_adaptation


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    directory: tyro.conf.Positional[Path]
    """Directory of the tables."""
    first: tyro.conf.Positional[str]
    """Beginning of the name of the first table, `NAME-seed-0.csv.gz`; or the whole name."""
    second: tyro.conf.Positional[str]
    """Likewise of the second."""
    seed: int = 0
    """Seed of both."""


def table(directory: Path, name: str, seed: int) -> AdaptationTable:
    """Read one of the tables."""
    whole = directory / name
    return read_adaptation(whole if whole.exists() else directory / f"{name}-seed-{seed}.csv.gz")


def main(settings: Settings) -> None:
    """Print the differences."""
    names = (settings.first, settings.second)
    first, second = (table(settings.directory, name, settings.seed) for name in names)
    both = min(first.num_tasks, second.num_tasks)
    print(f"episodes  {settings.first} - {settings.second}  tasks")
    for column, episodes in enumerate(first.episodes):
        (other,) = np.nonzero(second.episodes == episodes)
        if len(other):
            returns = first.mean_return[:both, column], second.mean_return[:both, other[0]]
            difference = returns[0] - returns[1]
            error = 1.96 * difference.std(ddof=1) / np.sqrt(both)
            print(f"{episodes:8d}  {difference.mean():.1f} ± {error:.1f}  {both}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
