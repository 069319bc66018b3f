"""Choose the devices that share the tasks of a meta-batch."""

import contextlib
import os
from collections.abc import Iterator

import jax

from maesn.numerics.mesh import sharing_tasks
from maesn.storage import RunError


def request_devices(number: int | None) -> None:
    """Let JAX have so many devices on a CPU, before anything else uses it. None: one a core.

    Raises:
        RunError: the number is not positive.
    """
    if number is not None and number < 1:
        raise RunError(f"`devices` must be at least 1, got {number}.")
    if (wanted := number or num_cores()) > 1:
        # JAX refuses this once it has started. The devices that it has may still be enough.
        with contextlib.suppress(RuntimeError):
            jax.config.update("jax_num_cpu_devices", wanted)  # type: ignore[no-untyped-call]


@contextlib.contextmanager
def sharing(number: int | None, tasks: int) -> Iterator[None]:
    """Let so many devices share the tasks of every meta-batch, until the block ends.

    Random draws do not depend on the number. Sums over tasks do, in their last digits, and training
    makes such differences grow.

    Args:
        number: of devices. None: on a CPU, the largest number up to that of the cores which divides
            `tasks`; else one.
        tasks: `AbstractMetaLearner.tasks_for_cores`.

    Raises:
        RunError: JAX has started with fewer devices.
    """
    found = jax.devices()
    if number is None:
        most = min(len(found), num_cores()) if found[0].platform == "cpu" else 1
        number = max(n for n in range(1, most + 1) if tasks % n == 0)
    if len(found) < number:
        raise RunError(
            f"`devices` is {number}, but JAX has begun with {len(found)}: ask for them before "
            "anything uses JAX, or set "
            f"XLA_FLAGS=--xla_force_host_platform_device_count={number} (on CPUs)."
        )
    with sharing_tasks(found[:number]):
        yield


def num_cores() -> int:
    """Return the number of cores that this process may compute on."""
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    limit = os.environ.get("NPROC", "")  # XLA's own limit on its threads
    return max(1, min(found or 1, int(limit))) if limit.isdecimal() else found or 1
