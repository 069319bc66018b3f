"""Fields of a model and of its data by name, before the first step."""

from collections.abc import Sequence

import mujoco
import numpy as np

from maesn.physics.base import find_field


def resting_readings(model: mujoco.MjModel, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the readings of one simulation at rest, for their shapes.

    Args:
        model: a compiled model.
        names: names of fields of `mujoco.MjData`.

    Raises:
        ValueError: there is no such field.
    """
    data = mujoco.MjData(model)
    unknown = [name for name in names if not hasattr(data, name)]
    if unknown:
        raise ValueError(f"`readings` must name fields of `mujoco.MjData`, got {unknown[0]!r}")
    return {name: np.asarray(getattr(data, name)) for name in names}


def field_values(model: mujoco.MjModel, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return values of a model's fields.

    Args:
        model: a compiled model.
        names: names of fields of `mujoco.MjModel`, or "opt.<field>" for its options.

    Raises:
        ValueError: there is no such field.
    """
    return {name: np.asarray(getattr(*find_field(model, name))) for name in names}
