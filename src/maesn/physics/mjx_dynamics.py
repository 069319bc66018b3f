"""Models on a device that differ from simulation to simulation."""

import copy
from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array

from maesn.physics.base import ModelFields, check_rows, find_field

# Leaves of MJX's model by their path in it, where a simulation has its own.
Dynamics: TypeAlias = dict[str, Array]

_Row: TypeAlias = dict[str, np.ndarray]


class ModelVariants:
    """A model on the device, and what changes in it when fields of `mujoco.MjModel` do.

    A variant is made by MuJoCo as a whole, derived quantities included, and put on the device as
    the model itself was. What then differs from the model is the variant: nothing can be forgotten
    that follows from a field.

    Args:
        compiled: the model itself.
        put: puts a model on the device.
    """

    def __init__(self, compiled: mujoco.MjModel, put: Callable[[mujoco.MjModel], Any]) -> None:
        self._compiled = compiled
        self._put = put
        self._own = put(compiled)
        self._known: dict[bytes, _Row] = {}

    def model(self, dynamics: Dynamics) -> Any:
        """Return the model of one simulation."""
        leaves = _named_leaves(self._own) | dynamics
        return jax.tree.unflatten(_structure(self._own), list(leaves.values()))

    def rows(self, fields: ModelFields) -> Dynamics:
        """Return the parts that depend on each simulation's fields; see `MjxEngine.dynamics`."""
        count = len(next(iter(fields.values()), ()))
        for name, values in fields.items():
            own = np.asarray(getattr(*find_field(self._compiled, name)))
            check_rows(name, values, np.broadcast_to(own, (count, *own.shape)))
        variants = [
            self._variant({name: np.asarray(values[row]) for name, values in fields.items()})
            for row in range(count)
        ]
        leaves = {name: np.asarray(leaf) for name, leaf in _named_leaves(self._own).items()}
        return {
            name: jnp.asarray(np.stack([variant.get(name, leaves[name]) for variant in variants]))
            for name in sorted({name for variant in variants for name in variant})
        }

    def _variant(self, fields: _Row) -> _Row:
        """Return the leaves in which the model with these fields differs."""
        key = b"".join(name.encode() + value.tobytes() for name, value in sorted(fields.items()))
        if key not in self._known:
            self._known[key] = self._differences(fields)
        return self._known[key]

    def _differences(self, fields: _Row) -> _Row:
        compiled = copy.copy(self._compiled)
        for name, value in fields.items():
            setattr(*find_field(compiled, name), value)
        mujoco.mj_setConst(compiled, mujoco.MjData(compiled))
        varied = self._put(compiled)
        if _structure(varied) != _structure(self._own):
            raise ValueError(
                f"`model_fields` cannot hold {', '.join(fields)} on the engine `mjx`, which "
                "compiles one of them, or something that follows from it, into the program: play "
                "this family on the engine `native`"
            )
        own = _named_leaves(self._own)
        leaves = {name: np.asarray(leaf) for name, leaf in _named_leaves(varied).items()}
        return {
            name: leaf
            for name, leaf in leaves.items()
            if not np.array_equal(leaf, np.asarray(own[name]), equal_nan=True)
        }


def _named_leaves(model: Any) -> dict[str, Any]:
    paths = jax.tree_util.tree_leaves_with_path(model)
    return {jax.tree_util.keystr(path): leaf for path, leaf in paths}


def _structure(model: Any) -> Any:
    """Return all of a model but the numbers that programs are given: what they are compiled for."""
    return jax.tree.structure(model)
