"""Compute a study on a Ray cluster: an executor of your own.

    pip install ray
    python examples/ray_cluster.py paper --out /shared/studies --workers 32

It uses the cluster of RAY_ADDRESS, else starts one on this machine. All nodes must see `--out` at
the same path. Each job takes as many CPUs as the study has threads.
"""

import argparse
import os
import sys
import tempfile
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import ray

import maesn
from maesn.foreign.pool import PYTHON
from maesn.runs.process import enable_compilation_cache
from maesn.studies.executors import thread_variables
from maesn.studies.jobs import Job, computed


class Ray(maesn.AbstractExecutor):
    """Computes so many jobs at a time on a Ray cluster, whose nodes must see their directory.

    A killed worker costs its job alone, which goes on elsewhere from its last checkpoint.
    """

    def __init__(self, workers: int, threads: int, jobs: Path) -> None:
        local = {} if os.environ.get("RAY_ADDRESS") else {"num_cpus": workers * threads}
        ray.init(log_to_driver=False, include_dashboard=False, ignore_reinit_error=True, **local)
        # The interpreter of environments with dependencies of their own (`--python`).
        hosts = {name: os.environ[name] for name in (PYTHON,) if name in os.environ}
        path = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        variables = path | hosts | thread_variables(threads)
        self._remote: Any = ray.remote(_on_cluster).options(
            num_cpus=threads, max_retries=0, runtime_env={"env_vars": variables}
        )
        self.slots = workers  # jobs wait in Ray's queue while no CPUs are free
        jobs.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=jobs, prefix="probe-") as probe:
            if not ray.get(self._remote.remote(Path.exists, Path(probe.name).resolve())):
                raise maesn.RunError(f"the cluster must see `{jobs.resolve()}`: share it.")

    def submit(self, job: Job, jobs: Path) -> Future[str | None]:
        """Begin a job somewhere on the cluster."""
        future: Future[str | None] = self._remote.remote(computed, job, jobs.resolve()).future()
        return future

    def close(self) -> None:
        """Stop all jobs; the same command goes on later."""
        ray.shutdown()


def _on_cluster(function: Any, *arguments: Any) -> Any:
    enable_compilation_cache()
    return function(*arguments)


def main() -> None:
    """Compute the study, and say how far it is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", help="a .toml file, or the name of a study of the library")
    parser.add_argument("--out", type=Path, required=True, help="directory that all nodes see")
    parser.add_argument("--workers", type=int, required=True, help="jobs at a time")
    asked = parser.parse_args()
    try:
        study = maesn.Study.load(asked.study)
        executor = Ray(asked.workers, study.spec.threads, asked.out / "jobs")
        study.run(asked.out, executor=executor, say=print)
    except maesn.RunError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
