"""What a model and its data hold under a name, before anything has moved."""

from collections.abc import Sequence

import mujoco
import numpy as np

from maesn.physics.base import find_field


def resting_readings(model: mujoco.MjModel, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return what an engine would read of one simulation, for its shapes.

    Args:
        model: a compiled model.
        names: of fields of `mujoco.MjData`.

    Raises:
        ValueError: there is no such field.
    """
    data = mujoco.MjData(model)
    unknown = [name for name in names if not hasattr(data, name)]
    if unknown:
        raise ValueError(f"`readings` must name fields of `mujoco.MjData`, got {unknown[0]!r}")
    return {name: np.asarray(getattr(data, name)) for name in names}


def field_values(model: mujoco.MjModel, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return a model's own dynamics.

    Args:
        model: a compiled model.
        names: of fields of `mujoco.MjModel`, or of its options as "opt.<field>".

    Raises:
        ValueError: there is no such field.
    """
    return {name: np.asarray(getattr(*find_field(model, name))) for name in names}
