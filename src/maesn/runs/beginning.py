"""How a new run begins with what another one has learned."""

from pathlib import Path
from typing import Any

from maesn.envs import AnyEnv
from maesn.runs.checkpoint import named_leaves, restore
from maesn.runs.config import read_config
from maesn.runs.run import Run
from maesn.runs.shipped import find_run
from maesn.storage import RunError


def begun_state(run: Run, source_directory: str | Path) -> Any:
    """Return a first state with what another run has learned, for the tasks of a new run.

    The policy, the step sizes, and all else that tasks share come from the source. What belongs to
    single tasks, such as the latents, begins afresh, and so does the count of iterations.

    Args:
        run: the new run.
        source_directory: of the other run, or the name of a policy that comes with the library.

    Raises:
        RunError: the source cannot be read or does not fit.
    """
    directory = find_run(source_directory)
    same_family = read_config(directory).family == run.config.family
    source = Run.open(directory, run.family if same_family else None)
    check_sizes(source, run.env(), "begin with a run in the same environment")
    fresh = run.untrained_state()
    iteration, rows = run.learner.iteration(fresh), _rows_of_tasks(run)
    values = named_leaves(source.latest_state())
    for name, leaf in named_leaves(fresh).items():
        if name in rows or leaf is iteration:
            values[name] = leaf
    return restore(fresh, values, source.directory)


def check_sizes(run: Run, env: AnyEnv, remedy: str) -> None:
    """Refuse a run whose policy cannot play in an environment, for its sizes.

    Args:
        run: whose policy.
        env: where it is to play.
        remedy: what the user should do.

    Raises:
        RunError: observation or action have other sizes there.
    """
    trained = run.env()
    for name in ("observation_size", "action_size"):
        wanted, found = getattr(env, name), getattr(trained, name)
        if wanted != found:
            raise RunError(
                f"`{run.directory}` must have an environment of `{name}` {wanted}, as this "
                f"`{env.name}` of variant `{env.variant}` has, got {found}: {remedy}."
            )


def _rows_of_tasks(run: Run) -> set[str]:
    """Return the names of the leaves that grow with the number of tasks: one row for each."""
    shapes = named_leaves(run.structure())
    larger = named_leaves(run.structure(len(run.training_tasks) + 1))
    return {name for name, leaf in shapes.items() if leaf.shape != larger[name].shape}
