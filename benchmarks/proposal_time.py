"""How long a robot's search thinks: to propose latents, and to learn from their returns.

    OPENBLAS_NUM_THREADS=1 python benchmarks/proposal_time.py wheeled ant blockpush

Searches are fed with the returns of their prior's training tasks, one episode at a time and in
rounds of four. Printed are the median and the 99th percentile of a call, in milliseconds of the
processor: what else the machine does is not counted.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import maesn
from maesn.runtime import Explorer


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    runs: tyro.conf.Positional[tuple[str, ...]] = ("wheeled", "ant", "blockpush")
    """Runs, or names of policies that come with the library."""
    episodes: int = 20
    """Of each search."""
    searches: int = 20
    """In the first so many training tasks."""


def search_once(policy: Path, task: int, episodes: int, count: int) -> np.ndarray:
    """Search in a training task; return the seconds of `propose` and `adapt`, `[round, 2]`."""
    explorer = Explorer.load(policy, seed=task)
    search = explorer.exported.search
    assert search is not None
    prior, spent = search.prior, []
    for _ in range(episodes // count):
        begin = time.thread_time()
        latents = explorer.propose(count)
        proposed = time.thread_time()
        for z in latents:
            nearest = np.linalg.norm(prior.latents - z, axis=1).argmin()
            got = prior.offset_mean + prior.excess[task, nearest]
            explorer.add_result(z, np.full(search.horizon, got / search.horizon))
        told = time.thread_time()
        explorer.adapt()
        spent.append((proposed - begin, time.thread_time() - told))
    return np.asarray(spent)


def main(settings: Settings) -> None:
    """Print the table."""
    print("run       at once  call     median ms  99th percentile ms")
    for run in settings.runs:
        with tempfile.TemporaryDirectory() as folder:
            policy = maesn.export(run, Path(folder) / "policy.npz", rule=maesn.SearchRule())
            for count in (1, 4):
                spent = 1e3 * np.concatenate(
                    [
                        search_once(policy, task, settings.episodes, count)
                        for task in range(settings.searches)
                    ]
                )
                for name, one in zip(("propose", "adapt"), spent.T, strict=True):
                    median, high = np.percentile(one, [50, 99])
                    print(f"{run:9s} {count:7d}  {name:8s} {median:9.2f} {high:19.2f}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Settings))
