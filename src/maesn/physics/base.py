"""What every physics engine on the host offers: many simulations of one model, moved together.

A simulator is the one stateful object of a rollout: it holds where every simulation is. It knows
no task, no reward and no episode. Row i of every array that goes in or comes out is simulation i.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Float64, Int, Shaped

# Engine quantities by their MuJoCo name ("qpos", "qvel", "subtree_com", ...), in SI units and in
# MuJoCo's layout. Every array is a copy that later steps leave alone.
Readings: TypeAlias = dict[str, Float64[np.ndarray, "simulation ..."]]

# Values of fields of `mujoco.MjModel` by name, one row for each simulation.
ModelFields: TypeAlias = Mapping[str, Shaped[np.ndarray, "simulation ..."]]

# Which simulations rows belong to: indices, or all.
Rows: TypeAlias = slice | np.ndarray

# What a step leaves current. Everything else MuJoCo derives at the beginning of a step, so that it
# describes the state one substep earlier unless it is computed again.
CURRENT = frozenset({"time", "qpos", "qvel", "act", "mocap_pos", "mocap_quat"})

# Beyond this size MuJoCo itself calls a number bad, and ignores it as it ignores NaN.
LARGEST = float(mujoco.mjMAXVAL)

_SHOWN = 5


class EngineError(ImportError):
    """The physics engine that an environment needs is not installed; the message says which."""


class PhysicsError(Exception):
    """Some simulations of a batch cannot go on.

    Attributes:
        simulations: the indices of the simulations that failed, ascending. The caller that made the
            batch knows which task and episode they are.
        reason: one sentence about the first of them.
    """

    def __init__(self, simulations: Sequence[int], reason: str) -> None:
        self.simulations: tuple[int, ...] = tuple(int(index) for index in simulations)
        self.reason = reason
        shown = ", ".join(map(str, self.simulations[:_SHOWN]))
        more = len(self.simulations) - _SHOWN
        rest = f" and {more} more" if more > 0 else ""
        super().__init__(f"simulation {shown}{rest}: {reason}")


def find_field(model: mujoco.MjModel, name: str) -> tuple[Any, str]:
    """Return the object that holds a field of a model, and the field's name in it.

    Args:
        model: the model.
        name: name of a field of `mujoco.MjModel`, or "opt.<field>" for one of its options.

    Raises:
        ValueError: there is no such field.
    """
    owner, _, field = name.rpartition(".")
    source = model.opt if owner == "opt" else model
    if owner not in ("", "opt") or not hasattr(source, field):
        raise ValueError(
            f"`model_fields` must name fields of `mujoco.MjModel`, or of its options as "
            f'"opt.<field>", got {name!r}'
        )
    return source, field


def check_rows(name: str, values: np.ndarray, whole: np.ndarray, rows: Rows = slice(None)) -> None:
    """Refuse values of a wrong shape, and numbers that MuJoCo would silently replace.

    Args:
        name: of what the values are.
        values: one row for each of these simulations.
        whole: an array like it for all simulations.
        rows: the simulations.
    """
    shape = whole[rows].shape
    if values.shape != shape:
        raise ValueError(f"`{name}` must have the shape {shape}, got {values.shape}")
    if not is_sound(values):
        failed = np.flatnonzero(~sound_rows(values))
        raise PhysicsError(
            np.arange(whole.shape[0])[rows][failed].tolist(),
            f"`{name}` must be finite and below {LARGEST:.0e} in size, got {values[failed[0]]}: "
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


class AbstractSimulator(ABC):
    """Many simulations of one model. Not to be shared between Python threads."""

    @property
    @abstractmethod
    def num_simulations(self) -> int:
        """Number of simulations."""

    @abstractmethod
    def reset(
        self,
        qpos: Float[np.ndarray, "row qpos"],
        qvel: Float[np.ndarray, "row qvel"],
        model_fields: ModelFields | None = None,
        simulations: Int[np.ndarray, " row"] | None = None,
    ) -> Readings:
        """Put simulations into a state, as if they had just been made.

        Args:
            qpos: generalised positions.
            qvel: generalised velocities.
            model_fields: dynamics that differ between simulations. Fields that are not named have
                the model's own values, whatever an earlier reset gave them.
            simulations: indices, ascending, of those that are reset and that the rows belong to;
                None for all. The others stay where they are.

        Returns:
            The readings of all simulations.

        Raises:
            PhysicsError: a state or a field is not finite.
        """

    @abstractmethod
    def step(
        self,
        control: Float[np.ndarray, "simulation control"],
        abandoned: Bool[np.ndarray, " simulation"] | None = None,
    ) -> Readings:
        """Advance every simulation by one control step.

        Args:
            control: input of the actuators, constant during the step.
            abandoned: simulations whose results are ignored until the next reset: they may blow up.

        Returns:
            The readings of the new state: none of them is a substep behind.

        Raises:
            PhysicsError: a control is not finite, or a simulation that counts has blown up.
        """

    @abstractmethod
    def close(self) -> None:
        """Release threads and memory. Nothing else may be called afterwards."""
