"""Worlds moved by JAX: a whole batch of episodes is one compiled scan."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from maesn.axes import Readings
from maesn.envs.base import AbstractPureEnv, Start
from maesn.envs.tasks import TaskSet
from maesn.worlds.base import AbstractWorld, Act, Actors, Decision, Moment, Trajectory


class DeviceWorld(AbstractWorld):
    """Plays an `AbstractPureEnv` on JAX's device, which manages its own threads."""

    env: AbstractPureEnv[Any]

    def __init__(self, env: AbstractPureEnv[Any], tasks: TaskSet) -> None:
        self.env = env
        self.tasks = tasks

    def play(self, act: Act, actors: Actors, start: Start) -> Trajectory:
        """It cannot fail: JAX raises no numerical errors."""
        return _scan(self.env, act, actors, {"qpos": start.qpos, "qvel": start.qvel})

    def close(self) -> None:
        """Do nothing: there are no threads or processes but JAX's own."""


@partial(jax.jit, static_argnums=(0, 1))
def _scan(env: AbstractPureEnv[Any], act: Act, actors: Actors, first: Readings) -> Trajectory:
    """Play one episode of `env.horizon` steps from each initial state, in one compiled program."""
    batch = actors.z.shape[:2]
    no_action, no_end = jnp.zeros((*batch, env.action_size)), jnp.zeros(batch, bool)

    def step(moment: Any, _: None) -> tuple[Moment, tuple[Readings, Decision]]:
        decision = act(actors, moment)
        readings = jax.vmap(env.advance)(moment.readings, jnp.asarray(decision.control))
        following = Moment(
            step=moment.step + 1,
            readings=readings,
            previous_readings=moment.readings,
            previous_action=decision.action,
            recurrent_state=decision.recurrent_state,
            ended=decision.ended,
        )
        return following, (readings, decision._replace(recurrent_state=None))

    recurrent_state = actors.trial_state.recurrent_state
    moment = Moment(jnp.zeros((), int), first, first, no_action, recurrent_state, no_end)
    last, (readings, decisions) = jax.lax.scan(step, moment, length=env.horizon)
    return Trajectory(
        readings=jax.tree.map(lambda x, xs: jnp.concatenate([x[None], xs]), first, readings),
        action=decisions.action,
        behaviour=decisions.behaviour,
        recurrent_state=last.recurrent_state,
    )
