"""Words, errors and checks of the physics."""

from collections.abc import Mapping
from typing import TypeAlias

import mujoco
import numpy as np
from jaxtyping import Bool, Float64, Shaped

# Engine quantities by their MuJoCo name ("qpos", "qvel", "subtree_com", ...), in SI units and in
# MuJoCo's layout. Every array is a copy that later steps leave alone.
Readings: TypeAlias = dict[str, Float64[np.ndarray, "simulation ..."]]

# Values of fields of `mujoco.MjModel` by name, one row for each simulation.
ModelFields: TypeAlias = Mapping[str, Shaped[np.ndarray, "simulation ..."]]

# What a step leaves current. Everything else MuJoCo derives at the beginning of a step, so that it
# describes the state one substep earlier unless it is computed again.
CURRENT = frozenset({"time", "qpos", "qvel", "act", "mocap_pos", "mocap_quat"})

# Beyond this size MuJoCo itself calls a number bad, and ignores it as it ignores NaN.
LARGEST = float(mujoco.mjMAXVAL)


class PhysicsError(Exception):
    """A simulation of a batch cannot go on.

    Attributes:
        simulation: its index; the first one's, if there are several. The caller that made the batch
            knows which task and episode it is.
        reason: one sentence.
    """

    def __init__(self, simulation: int, reason: str) -> None:
        super().__init__(f"simulation {simulation}: {reason}")
        self.simulation = simulation
        self.reason = reason


def check_rows(name: str, values: np.ndarray, present: np.ndarray) -> None:
    """Refuse values of another shape, and numbers that MuJoCo would silently replace."""
    if values.shape != present.shape:
        raise ValueError(f"`{name}` must have the shape {present.shape}, got {values.shape}")
    if not is_sound(values):
        failed = int(np.argmin(sound_rows(values)))
        raise PhysicsError(
            failed,
            f"`{name}` must be finite and below {LARGEST:.0e} in size, got {values[failed]}: "
            "look for what computed it, because MuJoCo would go on without it",
        )


def is_sound(values: np.ndarray) -> bool:
    """Whether all numbers are finite and below `LARGEST` in size."""
    # False for NaN too. No product: large ones wake threads that the engine then has to wait for.
    return bool(values.max(initial=0.0) <= LARGEST and values.min(initial=0.0) >= -LARGEST)


def sound_rows(values: np.ndarray) -> Bool[np.ndarray, " simulation"]:
    """Return which rows are sound."""
    size = np.abs(values.reshape(values.shape[0], -1))
    return size.max(axis=1, initial=0.0) <= LARGEST
