"""Simulations on `MjxEngine`, and each of their steps again on plain MuJoCo."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from physics.plain import plain_episodes

from maesn.physics import load_model
from maesn.physics.mjx import MjxEngine

# A compiler that optimises nothing takes half the time, and the programs here are run a few times.
QUICKLY: dict[str, Any] = {"xla_backend_optimization_level": 0}


# Pushed along x, it meets a block.
ROD = """
<mujoco>
  <option timestep="0.005" gravity="0 0 0"/>
  <default><geom margin="0.01" condim="1"/></default>
  <worldbody>
    <geom name="block" type="box" size="0.03 0.03 0.05" pos="0.15 0 0.05"/>
    <body pos="0 0 0.06">
      <joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 1 0"/>
      <joint type="hinge" axis="0 0 1"/>
      <geom name="rod" {rod}/>
    </body>
  </worldbody>
</mujoco>
"""


def quickly(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of one simulation, as a compiled one of a batch."""
    return jax.jit(jax.vmap(function), compiler_options=QUICKLY)


def one_step_errors(
    engine: MjxEngine, model: str | Path, qpos: Any, qvel: Any, control: Any, frame_skip: int = 1
) -> dict[str, np.ndarray]:
    """Differences from plain MuJoCo after every single step, largest of each simulation.

    MuJoCo starts every step from where MJX is, so that differences do not pile up.

    Args:
        engine: with the readings `qpos` and `qvel` at least.
        model: the engine's.
        qpos: of the start, `[simulation, qpos]`.
        qvel: the same.
        control: `[time, simulation, control]`.
        frame_skip: the engine's.

    Returns:
        `[time, simulation]` each, by the name of the reading.
    """
    step = quickly(engine.step)
    state, readings = quickly(engine.initial)(jnp.asarray(qpos), jnp.asarray(qvel), {})
    models = [load_model(model)] * len(qpos)
    errors: dict[str, list[np.ndarray]] = {name: [] for name in readings}
    for row in control:
        before = [np.asarray(readings[name], np.float64) for name in ("qpos", "qvel")]
        expected = plain_episodes(models, *before, row[None], tuple(readings), frame_skip)[-1]
        state, readings = step(state, jnp.asarray(row))
        for name, value in readings.items():
            size = np.abs(np.asarray(value) - expected[name])
            errors[name].append(size.reshape(len(qpos), -1).max(axis=1))
    return {name: np.stack(steps) for name, steps in errors.items()}
