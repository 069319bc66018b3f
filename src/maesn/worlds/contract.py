"""Check that an environment fits its declared sizes, and a policy the environment."""

import math
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from maesn.envs.base import AbstractMujocoEnv, AbstractPureEnv, AbstractSimulatedEnv, AnyEnv
from maesn.envs.hosted import AbstractGymnasiumEnv
from maesn.physics import field_values, load_model, resting_readings
from maesn.policies import USUAL, AbstractPolicy
from maesn.storage import RunError
from maesn.worlds.base import EnvContractError
from maesn.worlds.foreign import check_hosted


def check_policy(policy: AbstractPolicy, env: AnyEnv) -> None:
    """Refuse by `RunError` a policy of other actions, or that reads a reward that is lacking."""
    wanted, kind, shown = env.action_kind, policy.action_kind, policy.observed_reward
    if isinstance(env, AbstractGymnasiumEnv) and shown not in ("own", env.reward_kind):
        raise RunError(
            f"`{env.name}` gives the {env.reward_kind} reward alone, but the policy reads the "
            f"{shown} one: set `reward` to {shown}, or the policy's `observed_reward` to own."
        )
    if kind != wanted:
        raise RunError(
            f"`{env.name}` needs a policy of {wanted} actions, but this one chooses {kind} ones: "
            "give the learner another, as in "
            f'maesn.PRESETS["maesn"](policy=maesn.{type(USUAL[wanted]).__name__}()); for `rl2` and '
            f'its like, maesn.Recurrent(action_kind="{wanted}").'
        )


def check_env_contract(env: AnyEnv, task: Any) -> None:
    """Refuse an environment whose functions return other shapes than it declares.

    Readings and model fields that MuJoCo does not have are refused as well, and a control period
    that is not the model's. JAX works out the shapes; no episode is played. What a function raises
    is passed on. Environments of others are begun and stepped once.

    Raises:
        EnvContractError: a function returns another shape, or `control_period` is wrong.
        ValueError: there is no field of a name.
    """
    if isinstance(env, AbstractGymnasiumEnv):
        check_hosted(env, task)
    if not isinstance(env, AbstractSimulatedEnv):
        return
    for function, found, wanted in _declared(env, task):
        shapes = jax.tree.map(jnp.shape, found)
        if shapes != wanted:
            raise EnvContractError(
                f"`{env.name}`: `{function}` must return the shape {wanted}, got {shapes}."
            )


def _declared(env: AbstractSimulatedEnv[Any], task: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield a function's name, what it returns, and the shapes that it should have."""
    task = jax.tree.map(jnp.asarray, task)
    start = jax.eval_shape(env.start, jax.random.key(0), task)
    action = jnp.zeros(env.action_size)
    control = _control(env, action)
    readings: Any = {"qpos": start.qpos, "qvel": start.qvel}
    if isinstance(env, AbstractPureEnv):
        moved = jax.eval_shape(env.advance, readings, control)
        yield "advance", moved, jax.tree.map(jnp.shape, readings)
        yield "model_fields", start.model_fields, {}
    if isinstance(env, AbstractMujocoEnv):
        model = load_model(env.model)
        _check_period(env, model.opt.timestep)
        if control.shape == action.shape != (model.nu,):
            raise EnvContractError(
                f"`{env.name}`: `action_size` must be {model.nu}, as many as the model has "
                f"actuators, because `control` makes one number of each, got {env.action_size}."
            )
        resting = resting_readings(model, env.readings)
        readings = {name: jnp.asarray(value, jnp.float32) for name, value in resting.items()}
        fields = field_values(model, start.model_fields)
        yield "initial", (start.qpos, start.qvel), ((model.nq,), (model.nv,))
        yield "model_fields", start.model_fields, jax.tree.map(jnp.shape, fields)
        yield "control", control, (model.nu,)
    instruction = jax.eval_shape(env.instruction, task)
    yield "instruction", instruction, (instruction.size,)
    seen = jax.eval_shape(env.observe, readings)
    yield "observe", seen, (env.observation_size - instruction.size,)
    rewards = jax.eval_shape(env.reward, readings, action, readings, task)
    yield "reward", jax.tree.leaves(rewards), [(), ()]  # its two parts
    yield "terminated", jax.eval_shape(env.terminated, readings), ()
    yield "truncated", jax.eval_shape(env.truncated, readings), ()
    yield "solved", jax.eval_shape(env.solved, readings, task), ()
    if env.planar:
        yield "position", jax.eval_shape(env.position, seen), (2,)
        yield "position", jax.eval_shape(env.position, jnp.zeros(env.observation_size)), (2,)
        yield "goal", jax.eval_shape(env.goal, task), (2,)


def _control(env: AbstractSimulatedEnv[Any], action: Array) -> Any:
    try:
        return jax.eval_shape(env.control, action)
    except TypeError as error:  # of JAX, where shapes do not fit
        raise EnvContractError(
            f"`{env.name}`: `control` must take an action of `action_size` {env.action_size} "
            f"numbers, but JAX says: {' '.join(str(error).split())}"
        ) from error


def _check_period(env: AbstractMujocoEnv[Any], timestep: float) -> None:
    period = env.frame_skip * timestep
    if not math.isclose(env.control_period, period, rel_tol=1e-6):
        raise EnvContractError(
            f"`{env.name}`: `control_period` must be `frame_skip` times the time step of the "
            f"model, {env.frame_skip} * {timestep:g} s = {period:g} s, got "
            f"{env.control_period:g} s: robots are controlled at that rate."
        )
