"""An executor without processes of its own."""

from concurrent.futures import Future
from pathlib import Path

from maesn.studies.execution import AbstractExecutor, Failure, computed
from maesn.studies.jobs import Job


class Here(AbstractExecutor):
    """This process, one job after the other."""

    slots = 1

    def submit(self, job: Job, jobs: Path) -> Future[Failure | None]:
        future: Future[Failure | None] = Future()
        future.set_result(computed(job, jobs))
        return future
