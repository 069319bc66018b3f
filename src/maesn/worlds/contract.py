"""Whether an environment is what it announces, before it is played."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from maesn.envs.base import (
    AbstractMujocoEnv,
    AbstractPureEnv,
    AbstractSimulatedEnv,
    AnyEnv,
)
from maesn.physics import field_values, load_model, resting_readings


class EnvContractError(ValueError):
    """An environment is not what it says; the message names it, and what does not fit."""


def check_env_contract(env: AnyEnv, task: Any) -> None:
    """Refuse an environment whose functions return other shapes than it announces.

    Or one that reads or sets what MuJoCo does not have.

    JAX works out the shapes; no episode is played. Foreign environments are looked at where they
    are hosted, in `maesn.foreign`. What a function raises is passed on.

    Args:
        env: of whatever family.
        task: one of its tasks.

    Raises:
        EnvContractError: a function returns something that does not fit, or there is no field of
            a name; the message names it.
    """
    if not isinstance(env, AbstractSimulatedEnv):
        return
    for function, found, wanted in _promises(env, task):
        shapes = jax.tree.map(jnp.shape, found)
        if shapes != wanted:
            raise EnvContractError(
                f"`{env.name}`: `{function}` must return the shape {wanted}, got {shapes}."
            )


def _promises(env: AbstractSimulatedEnv[Any], task: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield a function's name, what it returns, and the shapes that it should have."""
    task = jax.tree.map(jnp.asarray, task)
    start = jax.eval_shape(env.start, jax.random.key(0), task)
    action = jnp.zeros(env.action_size)
    control = jax.eval_shape(env.control, action)
    readings: Any = {"qpos": start.qpos, "qvel": start.qvel}
    if isinstance(env, AbstractPureEnv):
        moved = jax.eval_shape(env.advance, readings, control)
        yield "advance", moved, jax.tree.map(jnp.shape, readings)
    if isinstance(env, AbstractMujocoEnv):
        model = load_model(env.model)
        with _naming(env):
            readings = _single(resting_readings(model, env.readings))
            fields = _single(field_values(model, tuple(start.model_fields)))
        yield "initial", (start.qpos, start.qvel), ((model.nq,), (model.nv,))
        yield "model_fields", start.model_fields, jax.tree.map(jnp.shape, fields)
        yield "control", control, (model.nu,)
    told = jax.eval_shape(env.instruction, task)
    yield "instruction", told, (told.size,)
    seen = jax.eval_shape(env.observe, readings)
    yield "observe", seen, (env.observation_size - told.size,)
    yield from _judgements(env, readings, action, task)
    if env.planar:
        yield "position", jax.eval_shape(env.position, seen), (2,)
        yield "position", jax.eval_shape(env.position, jnp.zeros(env.observation_size)), (2,)
        yield "goal", jax.eval_shape(env.goal, task), (2,)


@contextmanager
def _naming(env: AnyEnv) -> Iterator[None]:
    """Name the environment in what is said of the names that it uses."""
    try:
        yield
    except ValueError as error:
        raise EnvContractError(f"`{env.name}`: {error}.") from error


def _judgements(
    env: AbstractSimulatedEnv[Any], readings: Any, action: Array, task: Any
) -> Iterator[tuple[str, Any, Any]]:
    paid = jax.eval_shape(env.reward, readings, action, readings, task)
    yield "reward", jax.tree.leaves(paid), [(), ()]  # its two parts
    for name in ("terminated", "truncated"):
        yield name, jax.eval_shape(getattr(env, name), readings), ()
    yield "solved", jax.eval_shape(env.solved, readings, task), ()


def _single(values: Any) -> Any:
    return {name: jnp.asarray(value, jnp.float32) for name, value in values.items()}
