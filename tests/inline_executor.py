"""An executor without processes of its own."""

from concurrent.futures import Future
from pathlib import Path

from maesn.studies.execution import AbstractExecutor
from maesn.studies.jobs import Job, computed


class Here(AbstractExecutor):
    """This process, one job after the other."""

    slots = 1

    def submit(self, job: Job, jobs: Path) -> Future[str | None]:
        future: Future[str | None] = Future()
        future.set_result(computed(job, jobs))
        return future
