"""What an environment does to observations and actions, read off its own functions."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from maesn.envs.base import AbstractMujocoEnv, AbstractPureEnv, AnyEnv
from maesn.physics import load_model, model_actuators, resting_readings
from maesn.runtime import Actuators, Sensors
from maesn.runtime.arrays import float64

# An input far outside of every range: what it leads to is a limit. What grows with the input to
# half that size has none.
_FAR = 1e6
_PROBE_STEP = 2.0**-10  # powers of two, so that the scale is exact in single precision
_NUM_PROBES = 256
_TOLERANCE = 1e-4  # for environments with an offset, where it is not
_NEAR = 0.01  # standard deviation of the smallest probes


def probe_actuators(env: AnyEnv) -> Actuators:
    """Return `env.control` as the numbers of clip(offset + scale * action, lower, upper).

    They are read off the function itself, and compared with it on random actions: `ValueError` if
    it has another form. The limits are the tightest of those in `control` and of the world.
    """

    def control(action: float | np.ndarray) -> np.ndarray:
        return float64(_controls(env, np.full((1, env.action_size), action, np.float32)))[0]

    lower, upper = _limits(control)
    offset = control(0.0)
    # The longest step that no limit cuts has the least rounding. A step of half the room is safe.
    rough = np.abs(control(_PROBE_STEP) - control(-_PROBE_STEP)) / (2 * _PROBE_STEP)
    room = np.minimum(upper - offset, offset - lower) / (2 * np.maximum(rough, _PROBE_STEP))
    step = 2.0 ** np.floor(np.log2(np.clip(room, _PROBE_STEP, 1.0)))
    scale = (control(step) - control(-step)) / (2 * step)
    own = Actuators(offset, scale, lower, upper, ("",) * env.action_size)
    actions = _probes(env.action_size)
    wanted = float64(_controls(env, actions.astype(np.float32)))
    fits = np.isclose(own.control(actions), wanted, _TOLERANCE, _TOLERANCE).all(axis=1)
    if not fits.all():
        index = int(np.argmin(fits))
        raise ValueError(
            f"`env.control` of `{env.name}` must be clip(offset + scale * action, lower, upper) "
            f"for each actuator, but the action {actions[index]} becomes {wanted[index]}."
        )
    if not isinstance(env, AbstractMujocoEnv):
        return own
    names, lower, upper = model_actuators(env.model)
    return replace(own, names=names).narrowed(lower, upper)


def probe_sensors(env: AnyEnv, task: Any) -> Sensors:
    """Return the names of an observation's components, and what each one is clipped to.

    A limit is what a component gets to far out and never passes. It is read off readings of all
    sizes; without one of its tasks, an environment in JAX has none of a known shape.
    """
    size = env.observation_size
    lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
    shapes = _reading_shapes(env, task)
    if shapes:

        def observe(number: float) -> np.ndarray:
            return _observed(env, {name: np.full((1, *one), number) for name, one in shapes})[0]

        low, high = _limits(observe)
        probes = {name: _probes(*one, seed=seed) for seed, (name, one) in enumerate(shapes)}
        seen = _observed(env, probes)
        within = (low - _TOLERANCE <= seen) & (seen <= high + _TOLERANCE)
        clips = within.all(axis=0) & (low < high)
        # The instruction, which comes last, is not clipped.
        lower[: low.size] = np.where(clips, low, -np.inf)
        upper[: low.size] = np.where(clips, high, np.inf)
    return Sensors(env.observation_names() or ("",) * size, lower, upper)


# Compiled once for equal environments.
@partial(jax.jit, static_argnums=0)
def _controls(env: AnyEnv, actions: Array) -> Array:
    return jax.vmap(env.control)(actions)


def _observed(env: AnyEnv, readings: dict[str, np.ndarray]) -> np.ndarray:
    """Return what an environment makes of readings `[state, ...]`, `[state, component]`."""
    return float64(_observations(env, {n: x.astype(np.float32) for n, x in readings.items()}))


@partial(jax.jit, static_argnums=0)
def _observations(env: AnyEnv, readings: dict[str, Array]) -> Array:
    return jax.vmap(env.observe)(readings)


def _reading_shapes(env: AnyEnv, task: Any) -> list[tuple[str, tuple[int, ...]]]:
    """Return name and shape of each reading; none of an environment that only others move."""
    readings: dict[str, Any] = {}
    if isinstance(env, AbstractMujocoEnv):
        readings = resting_readings(load_model(env.model), env.readings)
    elif isinstance(env, AbstractPureEnv) and task is not None:
        start = jax.eval_shape(env.start, jax.random.key(0), jax.tree.map(jnp.asarray, task))
        readings = {"qpos": start.qpos, "qvel": start.qvel}
    return [(name, value.shape) for name, value in readings.items()]


def _probes(*shape: int, seed: int = 0) -> np.ndarray:
    """Return random inputs of all sizes, `[probe, *shape]`."""
    sizes = np.geomspace(_NEAR, _FAR, _NUM_PROBES).reshape(-1, *(1 for _ in shape))
    return sizes * np.random.default_rng(seed).standard_normal((_NUM_PROBES, *shape))


def _limits(function: Callable[[float], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and the largest that a function gets to, infinite if it goes on."""
    far, half = (np.stack([function(-x), function(x)]) for x in (_FAR, _FAR / 2))
    limits = np.where(far == half, far, np.copysign(np.inf, far))
    return limits.min(axis=0), limits.max(axis=0)
