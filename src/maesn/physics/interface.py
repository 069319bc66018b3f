"""What a model calls its readings, fields and actuators, and which controls it lets through."""

import os
from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from maesn.physics.loading import load_model

_OBJECT = mujoco.mjtObj
# Readings that are laid out object by object: the kind of object, and where each one begins.
_LAYOUTS = {
    "qpos": (_OBJECT.mjOBJ_JOINT, "jnt_qposadr"),
    "qvel": (_OBJECT.mjOBJ_JOINT, "jnt_dofadr"),
    "sensordata": (_OBJECT.mjOBJ_SENSOR, "sensor_adr"),
}


def model_actuators(
    model: str | os.PathLike[str],
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Return the actuators of a model: names, smallest and largest controls, `[actuator]`.

    These are the limits that the engine clips to, infinite where it does not.
    """
    compiled = load_model(model)
    clips = not compiled.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    limited = compiled.actuator_ctrllimited.astype(bool) & clips
    lower, upper = compiled.actuator_ctrlrange.T
    names = tuple(_name(compiled, _OBJECT.mjOBJ_ACTUATOR, i) for i in range(compiled.nu))
    return names, np.where(limited, lower, -np.inf), np.where(limited, upper, np.inf)


def reading_owners(model: str | os.PathLike[str], reading: str, size: int) -> tuple[str, ...]:
    """Return the joint or sensor that each number of a reading belongs to; "" where none does.

    The reading is a field of `mujoco.MjData` of that many numbers.
    """
    if reading not in _LAYOUTS:
        return ("",) * size
    compiled, (kind, start) = load_model(model), _LAYOUTS[reading]
    owner = np.searchsorted(getattr(compiled, start), np.arange(size), side="right") - 1
    return tuple(_name(compiled, kind, int(index)) for index in owner)


def resting_readings(model: mujoco.MjModel, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return fields of `mujoco.MjData` at rest; ValueError if there is no such field."""
    data = mujoco.MjData(model)
    unknown = [name for name in names if not hasattr(data, name)]
    if unknown:
        raise ValueError(f"`readings` must name fields of `mujoco.MjData`, got {unknown[0]!r}")
    return {name: np.asarray(getattr(data, name)) for name in names}


def field_values(model: mujoco.MjModel, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Return fields of a model, or "opt.<field>" of its options; ValueError if one is unknown."""
    values = {}
    for name in names:
        owner, _, field = name.rpartition(".")
        source = model.opt if owner == "opt" else model
        if owner not in ("", "opt") or not hasattr(source, field):
            raise ValueError(
                f"`model_fields` must name fields of `mujoco.MjModel`, or of its options as "
                f'"opt.<field>", got {name!r}'
            )
        values[name] = np.asarray(getattr(source, field))
    return values


def _name(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> str:
    return mujoco.mj_id2name(model, kind, index) or ""
