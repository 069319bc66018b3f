"""What a machine can hold: the memory of episodes before the first one is played, and the CPUs."""

import contextlib
import os
from pathlib import Path

from maesn.envs.base import AnyEnv
from maesn.storage import RunError

# Share of the memory that `least_bytes` of tasks which advance together may fill. With what an
# update keeps beside its episodes, gradients on `wheeled` take five times that.
SHARE = 0.02


def check_memory(env: AnyEnv, num_episodes: int) -> None:
    """Refuse by `RunError` a batch of episodes that this machine cannot hold."""
    needed = least_bytes(env, num_episodes)
    if needed > memory():
        raise RunError(
            f"{num_episodes:,} episodes of {env.horizon:,} steps of `{env.name}` at once take at "
            f"least {needed / 1e9:,.1f} GB, but this machine has {memory() / 1e9:,.1f} GB: play "
            "fewer episodes of each task, or fewer tasks at once."
        )


def least_bytes(env: AnyEnv, num_episodes: int) -> int:
    """Return the least that any method keeps of episodes, in single precision.

    Of a step: observation, action, its noise, mean and standard deviation, and six numbers and
    flags.
    """
    return 4 * num_episodes * env.horizon * (env.observation_size + 4 * env.action_size + 6)


def tasks_that_fit(env: AnyEnv, episodes_per_task: int) -> int:
    """Return how many tasks can advance together in the memory of this machine, at least 1."""
    return max(1, int(SHARE * memory() // least_bytes(env, episodes_per_task)))


def memory() -> int:
    """Return the bytes of memory that a process on this machine, or in this container, can get."""
    bytes_ = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with contextlib.suppress(OSError, ValueError):
        bytes_ = min(bytes_, int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return bytes_


def num_cpus() -> int:
    """Return the number of CPUs that this process may use, where the system says."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
