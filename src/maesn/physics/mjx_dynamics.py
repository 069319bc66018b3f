"""Models on a device that differ from simulation to simulation."""

import copy
from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array

from maesn.physics.base import ModelFields, PhysicsError, find_field

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
        # Names that some variant so far differs in. They only grow, so that programs are compiled
        # again when something new varies, and not whenever a value happens to be the model's own.
        self._varied: set[str] = set()

    def model(self, dynamics: Dynamics) -> Any:
        """Return the model of one simulation."""
        if not dynamics:
            return self._own
        leaves = _named_leaves(self._own) | dynamics
        return jax.tree.unflatten(_structure(self._own), list(leaves.values()))

    def rows(self, fields: ModelFields) -> Dynamics:
        """Return the parts that depend on each simulation's fields; see `MjxEngine.dynamics`."""
        if not fields:
            return {}
        for name, values in fields.items():
            self._check(name, values)
        count = len(next(iter(fields.values())))
        variants = [
            self._variant({name: np.asarray(values[row]) for name, values in fields.items()})
            for row in range(count)
        ]
        self._varied.update(*variants)
        own = {name: np.asarray(leaf) for name, leaf in _named_leaves(self._own).items()}
        return {
            name: jnp.asarray(np.stack([variant.get(name, own[name]) for variant in variants]))
            for name in sorted(self._varied)
        }

    def _check(self, name: str, values: np.ndarray) -> None:
        shape = np.shape(getattr(*find_field(self._compiled, name)))
        if values.shape[1:] != shape:
            raise ValueError(
                f"`{name}` must have the shape {('simulation', *shape)}, got {values.shape}"
            )
        failed = np.flatnonzero(~np.isfinite(values).reshape(len(values), -1).all(axis=1))
        if failed.size:
            raise PhysicsError(
                failed.tolist(),
                f"`{name}` must be finite, got {values[failed[0]]}: look for what computed it",
            )

    def _variant(self, fields: _Row) -> _Row:
        key = b"".join(name.encode() + value.tobytes() for name, value in sorted(fields.items()))
        if key not in self._known:
            self._known[key] = self._differences(fields)
        return self._known[key]

    def _differences(self, fields: _Row) -> _Row:
        varied, own = self._with(fields), self._own
        if _structure(varied) != _structure(own):
            fixed = [name for name in fields if not self._may_vary(name, fields[name])]
            raise ValueError(
                f"`model_fields` cannot hold {', '.join(fixed or fields)} on the engine `mjx`, "
                "which compiles it, or something that follows from it, into the program: play "
                "this family on the engine `native`"
            )
        leaves = {name: np.asarray(leaf) for name, leaf in _named_leaves(varied).items()}
        return {
            name: leaves[name]
            for name, leaf in _named_leaves(own).items()
            if not np.array_equal(leaves[name], np.asarray(leaf), equal_nan=True)
        }

    def _may_vary(self, name: str, value: np.ndarray) -> bool:
        return _structure(self._with({name: value})) == _structure(self._own)

    def _with(self, fields: _Row) -> Any:
        """Return the model on the device with other fields, and all that follows from them."""
        varied = copy.copy(self._compiled)
        for name, value in fields.items():
            setattr(*find_field(varied, name), value)
        mujoco.mj_setConst(varied, mujoco.MjData(varied))
        return self._put(varied)


def _named_leaves(model: Any) -> dict[str, Any]:
    paths = jax.tree_util.tree_leaves_with_path(model)
    return {jax.tree_util.keystr(path): leaf for path, leaf in paths}


def _structure(model: Any) -> Any:
    """Return all of a model but the numbers that programs are given: what they are compiled for."""
    return jax.tree.structure(model)
