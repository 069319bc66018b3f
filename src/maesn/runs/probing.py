"""What an environment does to observations and actions, read off its own functions."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from itertools import repeat
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from maesn.envs.base import AbstractMujocoEnv, AbstractPureEnv, AbstractSimulatedEnv, AnyEnv
from maesn.physics import load_model, model_actuators, reading_owners, resting_readings
from maesn.runtime import Actuators, Sensors
from maesn.runtime.arrays import float64

Shapes: TypeAlias = tuple[tuple[str, tuple[int, ...]], ...]
"""Name and shape of each of some readings."""

# An input far outside of every range: what it leads to is a limit. What grows with the input to
# half that size has none.
_FAR = 1e6
_LONGEST, _SHORTEST = 2.0**18, 2.0**-30  # steps from an input to one of two around it
_CLOSE = 1e-3  # as a share of the value: from there to a limit, steps are rounded too much
_NUM_PROBES = 256
_TOLERANCE = 1e-4  # for environments with an offset, where it is not
_NEAR = 0.01  # standard deviation of inputs that are not clipped


def probe_actuators(env: AnyEnv) -> Actuators:
    """Return `env.control` as the numbers of clip(offset + scale * action, lower, upper).

    They are read off the function itself, and compared with it on random actions: `ValueError` if
    it has another form. The limits are the tightest of those in `control` and of the world.
    """

    def control(action: float | np.ndarray) -> np.ndarray:
        return float64(_controls(env, np.full((1, env.action_size), action, np.float32)))[0]

    lower, upper = _limits(control)
    free = _uncut(control, lower, upper)
    value = control(free)
    before, after = _apart(control, free, lower, upper)
    scale = (control(after) - control(before)) / (after - before)
    offset = value - scale * free
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


def _uncut(
    control: Callable[[float | np.ndarray], np.ndarray], lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """Return for each actuator an action whose control is not close to a limit: 0 if it is one.

    Else it is found by bisection, and leads halfway between the limits, or 1 from a single one.
    """
    resting = control(0.0)
    inner = np.where(np.isfinite(lower), lower + 1.0, upper - 1.0)
    with np.errstate(invalid="ignore"):  # of two infinite limits
        middle = (lower + upper) / 2
    wanted = np.where(np.isfinite(middle), middle, inner)
    rises = control(_FAR) >= control(-_FAR)
    ends = np.full_like(resting, -_FAR), np.full_like(resting, _FAR)
    for _ in range(64):
        half = (ends[0] + ends[1]) / 2
        is_before = (control(half) < wanted) == rises
        ends = np.where(is_before, half, ends[0]), np.where(is_before, ends[1], half)
    found = float64(np.float32(ends[0]))
    room = np.minimum(upper - resting, resting - lower)
    is_free = (room > _CLOSE * np.abs(resting)) | (lower == upper)
    return np.where(is_free, 0.0, found)


def _apart(
    control: Callable[[float | np.ndarray], np.ndarray],
    free: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return for each actuator `free` less and plus the longest step that no limit cuts.

    Of steps that are powers of two: the longest has the least rounding.
    """
    step = np.full_like(free, _LONGEST)
    shortest = np.maximum(_SHORTEST, np.abs(free) * 2.0**-20)  # what single precision can tell
    while True:
        ends = [float64(np.float32(free + sign * step)) for sign in (-1.0, 1.0)]
        values = np.stack([control(end) for end in ends])
        is_cut = ((values <= lower) | (values >= upper)).any(axis=0) & (step > shortest)
        if not is_cut.any():
            return ends[0], ends[1]
        step = np.where(is_cut, step / 2, step)


def probe_sensors(env: AnyEnv, task: Any) -> Sensors:
    """Return what each component of an observation is, and what it is clipped to.

    A component that is one number of the readings, scaled, shifted or clipped, is named after it.
    Any other is named after the function that computes it. Without one of its tasks, an environment
    in JAX has readings without names.
    """
    size = env.observation_size
    far = np.full(size, np.inf)
    sensors = Sensors((_computed(env),) * size, -far, far)
    if isinstance(env, AbstractMujocoEnv) or (
        task is not None and isinstance(env, AbstractPureEnv)
    ):
        sensors = _copies(env, task)
    return replace(sensors, names=env.observation_names() or sensors.names)


def _computed(env: AnyEnv) -> str:
    return f"computed by `{env.name}`"


def _copies(env: AbstractSimulatedEnv[Any], task: Any) -> Sensors:
    """Return the sensors of an environment, with names of what is copied from the readings."""
    readings = _at_rest(env, task)
    labels = [label for name, value in readings.items() for label in _labels(env, name, value)]
    shapes = tuple((name, value.shape) for name, value in readings.items())
    rest = np.concatenate([np.ravel(value) for value in readings.values()])

    def observe(flat: np.ndarray) -> np.ndarray:
        return float64(_observations(env, shapes, flat.astype(np.float32)))

    near = rest + _NEAR * np.random.default_rng(1).standard_normal(rest.size)
    slope = float64(_slopes(env, shapes, near.astype(np.float32)))
    offset = observe(near[None])[0]
    source = np.abs(slope).argmax(axis=1)
    scale = np.take_along_axis(slope, source[:, None], axis=1)[:, 0]
    offset -= scale * near[source]
    offset[np.abs(offset) < _TOLERANCE] = 0.0
    lower, upper = _limits(lambda x: observe(np.full((1, rest.size), x))[0])
    copied = Actuators(offset, scale, lower, upper)  # the same form
    fits = (slope != 0).sum(axis=1) == 1
    probes = _probes(rest.size)
    copies = copied.control(probes[:, source])
    fits &= np.isclose(copies, observe(probes), _TOLERANCE, _TOLERANCE).all(axis=0)
    names = [
        _written(labels[source[index]], scale[index], offset[index])
        if fits[index]
        else _computed(env)
        for index in range(len(offset))
    ]
    instructions = [f"instruction[{index}]" for index in range(env.observation_size - len(names))]
    free = np.full(len(instructions), np.inf)
    return Sensors(
        (*names, *instructions),
        np.append(np.where(fits, lower, -np.inf), -free),
        np.append(np.where(fits, upper, np.inf), free),
    )


# Compiled once for equal environments.
@partial(jax.jit, static_argnums=0)
def _controls(env: AnyEnv, actions: Array) -> Array:
    return jax.vmap(env.control)(actions)


@partial(jax.jit, static_argnums=(0, 1))
def _observations(env: AnyEnv, shapes: Shapes, flat: Array) -> Array:
    return jax.vmap(partial(_observed, env, shapes))(flat)


@partial(jax.jit, static_argnums=(0, 1))
def _slopes(env: AnyEnv, shapes: Shapes, flat: Array) -> Array:
    return jax.jacfwd(partial(_observed, env, shapes))(flat)


def _observed(env: AnyEnv, shapes: Shapes, flat: Array) -> Array:
    """Return the observation of readings that stand one behind the other in an array."""
    sizes = [math.prod(shape) for _, shape in shapes]
    parts = jnp.split(flat, np.cumsum(sizes)[:-1])
    pairs = zip(shapes, parts, strict=True)
    return env.observe({name: part.reshape(shape) for (name, shape), part in pairs})


def _at_rest(env: AbstractSimulatedEnv[Any], task: Any) -> dict[str, np.ndarray]:
    if isinstance(env, AbstractMujocoEnv):
        return resting_readings(load_model(env.model), env.readings)
    start = env.start(jax.random.key(0), jax.tree.map(jnp.asarray, task))
    return {"qpos": np.asarray(start.qpos), "qvel": np.asarray(start.qvel)}


def _labels(env: AnyEnv, name: str, value: np.ndarray) -> list[str]:
    owners: Iterable[str] = repeat("", value.size)
    if isinstance(env, AbstractMujocoEnv):
        owners = reading_owners(env.model, name, value.size)
    places = (f"{name}[{', '.join(map(str, index))}]" for index in np.ndindex(value.shape))
    return [place + (f" {own}" if own else "") for place, own in zip(places, owners, strict=True)]


def _written(label: str, scale: float, offset: float) -> str:
    scaled = label if np.isclose(scale, 1.0) else f"{scale:.6g} * {label}"
    return scaled if offset == 0 else f"{scaled} {'+' if offset > 0 else '-'} {abs(offset):.6g}"


def _probes(size: int) -> np.ndarray:
    """Return random inputs of all sizes, `[probe, size]`."""
    sizes = np.geomspace(_NEAR, _FAR, _NUM_PROBES)[:, None]
    return sizes * np.random.default_rng(0).standard_normal((_NUM_PROBES, size))


def _limits(function: Callable[[float], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and the largest that a function gets to, infinite if it goes on."""
    far, half = (np.stack([function(-x), function(x)]) for x in (_FAR, _FAR / 2))
    limits = np.where(far == half, far, np.copysign(np.inf, far))
    return limits.min(axis=0), limits.max(axis=0)
