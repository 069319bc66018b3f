"""MuJoCo on an accelerator: the models of the native engine as pure functions of JAX.

MJX computes what MuJoCo computes, in single precision and for one simulation at a time, so that
`jax.vmap` makes a batch of it and `jax.lax.scan` an episode. `docs/explanation/engines.md` says
where the two differ.
"""

import contextlib
import dataclasses
import importlib
import importlib.util
import io
import os
from collections.abc import Callable, Iterator
from operator import attrgetter
from types import ModuleType
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np
from jaxtyping import Array, Float

from maesn.axes import Readings
from maesn.physics.base import CURRENT, EngineError, ModelFields
from maesn.physics.loading import label, load_model
from maesn.physics.mjx_dynamics import Dynamics, ModelVariants
from maesn.physics.mjx_margins import MarginError, margins_as_sizes

# What follows from the forces between bodies.
_BODY_FORCES = frozenset({"cacc", "cfrc_ext", "cfrc_int"})
# Fields that MJX has but never fills would read as zeros, so what can be read is what was compared
# with MuJoCo: see `tests/long/physics/test_mjx.py`.
READABLE = (
    *("time", "qpos", "qvel", "act", "mocap_pos", "mocap_quat", "qacc", "sensordata"),
    *("xpos", "xquat", "xmat", "xipos", "ximat", "xanchor", "xaxis", "subtree_com", "cvel"),
    *("geom_xpos", "geom_xmat", "site_xpos", "site_xmat", "actuator_force", "actuator_length"),
    *("actuator_velocity", "qfrc_bias", "qfrc_passive", "qfrc_actuator", "qfrc_constraint"),
    *("cacc", "cfrc_ext", "cfrc_int"),
)


class MjxState(NamedTuple):
    """One simulation: all that its next step depends on."""

    data: Any
    """MJX's own."""
    dynamics: Dynamics


class MjxEngine:
    """A model on JAX's device. `initial` and `step` are pure functions of one simulation.

    Args:
        model: as for `load_model`.
        readings: names of the fields of `mujoco.MjData` that `initial` and `step` return.
        frame_skip: physics steps per control step.

    Raises:
        EngineError: MJX is not installed.
        ValueError: MJX lacks something that the model or the readings need, or an argument is out
            of range. Else it raises as `load_model`.
    """

    def __init__(
        self,
        model: str | os.PathLike[str],
        readings: tuple[str, ...] = ("qpos", "qvel"),
        frame_skip: int = 1,
    ) -> None:
        unknown = [name for name in readings if name not in READABLE]
        if unknown:
            raise ValueError(
                f"`readings` of the engine `mjx` must be among {', '.join(READABLE)}, got "
                f"{unknown[0]!r}: play this family on the engine `native`"
            )
        if frame_skip < 1:
            raise ValueError(f"`frame_skip` must be at least 1, got {frame_skip}")
        self._mjx, self._frame_skip = import_mjx(), frame_skip
        compiled = load_model(model)
        try:
            with _own_rules():
                self._variants = ModelVariants(compiled, self._put)
                self._blank = self._mjx.make_data(margins_as_sizes(compiled))
        except (NotImplementedError, MarginError) as error:  # the first is MJX's own
            raise ValueError(
                f"model {label(model)!r} cannot be moved by the engine `mjx`, which lacks "
                f"something that it needs: {error}; play it on the engine `native`"
            ) from error
        self._readers = {name: self._reader(name, compiled) for name in readings}
        self._derives = not CURRENT.issuperset(readings)
        self._needs_forces = not _BODY_FORCES.isdisjoint(readings)

    def dynamics(self, model_fields: ModelFields) -> Dynamics:
        """Return the parts of the model that depend on the fields, `[simulation, ...]`.

        Do not call it in a compiled program: MuJoCo itself (`mj_setConst`) computes the derived
        parts on the host, once for each distinct row.

        Raises:
            PhysicsError: a value is not finite.
            ValueError: there is no such field, its rows have another shape, or MJX has compiled it
                in, so that simulations cannot differ in it.
        """
        with _own_rules():
            return self._variants.rows(model_fields)

    def initial(
        self, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"], dynamics: Dynamics
    ) -> tuple[MjxState, Readings]:
        """Return a simulation in a state, with nothing before it, and the readings of that state.

        Its dynamics are of `MjxEngine.dynamics`; empty for the model's.
        """
        with _own_rules():
            dtype = self._blank.qpos.dtype
            data = self._blank.replace(qpos=qpos.astype(dtype), qvel=qvel.astype(dtype))
            return self._derived(data, dynamics)

    def step(self, state: MjxState, control: Float[Array, " control"]) -> tuple[MjxState, Readings]:
        """Advance a simulation by one control step, and return its readings, none a substep behind.

        What blows up is neither reset nor reported: its numbers are simply no longer finite.
        """
        with _own_rules():
            model = self._variants.model(state.dynamics)
            data = state.data.replace(ctrl=control.astype(self._blank.ctrl.dtype))
            if self._frame_skip == 1:
                data = self._mjx.step(model, data)
            else:
                data = jax.lax.fori_loop(
                    0, self._frame_skip, lambda _, d: self._mjx.step(model, d), data
                )
            return self._derived(data, state.dynamics)

    def _derived(self, data: Any, dynamics: Dynamics) -> tuple[MjxState, Readings]:
        if self._derives:
            model = self._variants.model(dynamics)
            data = self._mjx.forward(model, data)
            if self._needs_forces:
                data = self._mjx.rne_postconstraint(model, data)
        readings = {name: read(data) for name, read in self._readers.items()}
        return MjxState(data, dynamics), readings

    def _put(self, compiled: mujoco.MjModel) -> Any:
        return self._mjx.put_model(margins_as_sizes(compiled))

    def _reader(self, name: str, compiled: mujoco.MjModel) -> Callable[[Any], Array]:
        """Return a function that reads a quantity in the layout of `mujoco.MjData`."""
        shape = np.shape(getattr(mujoco.MjData(compiled), name))
        public = {field.name for field in dataclasses.fields(self._blank)}
        find = attrgetter(name if name in public else f"_impl.{name}")
        return lambda data: find(data).reshape(shape)


def import_mjx() -> ModuleType:
    """Return the module `mujoco.mjx`; EngineError if it is not installed."""
    if importlib.util.find_spec("mujoco.mjx") is None:
        raise EngineError(
            "the engine `mjx` needs the package mujoco-mjx, which is not installed: "
            "`pip install -e '.[gpu]'` brings it, and JAX for NVIDIA cards"
        )
    # It prints that it has not found Warp, which it could use as well.
    with contextlib.redirect_stdout(io.StringIO()):
        return importlib.import_module("mujoco.mjx")


@contextlib.contextmanager
def _own_rules() -> Iterator[None]:
    """Run MJX by the rules that it is written for.

    JAX's default matrix product on graphics cards has 10 bits of mantissa (TF32), which is no
    precision to solve for contact forces with.
    """
    with (
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
        jax.default_matmul_precision("highest"),
    ):
        yield
