"""Families of the environments in `strangers`."""

import os
from pathlib import Path
from typing import Any

import jax
import numpy as np
from playing import keys
from strangers import HORIZON, draw_walks, make_broken, make_painter, make_settable, make_walker

from maesn.envs import TaskFamily
from maesn.envs.foreign import gymnasium_family

EPISODES = 3
SEED = 3


def family_of(make_env: Any, **settings: Any) -> TaskFamily:
    """A family of walkers, unless the environment says otherwise."""
    defaults: dict[str, Any] = {"horizon": HORIZON, "time_limit": 60.0}
    return gymnasium_family("stranger", make_env, draw_walks, **defaults | settings)


walkers = family_of(make_walker)
painters = family_of(make_painter)
settable = family_of(make_settable)
broken = family_of(make_broken)
impatient = family_of(make_broken, time_limit=2.0)


def seeds(num_tasks: int) -> np.ndarray:
    """What the episodes are reset with: the start key of each, as 32 random bits."""
    return np.array(
        [
            [
                jax.random.bits(jax.random.split(jax.random.fold_in(key, episode), 3)[1])
                for episode in range(EPISODES)
            ]
            for key in keys(num_tasks, SEED)
        ]
    )


def is_running(process: int) -> bool:
    """Whether a process is there and has not ended; who should, may not have been told yet."""
    try:
        os.kill(process, 0)
        status = Path(f"/proc/{process}/stat")  # of Linux
        state = status.read_text().rpartition(")")[2].split()[0] if status.exists() else ""
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"
