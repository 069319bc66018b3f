"""Worlds written in JAX: a whole batch of episodes is one compiled scan."""

from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp

from maesn.axes import Carry, Readings
from maesn.envs.base import AbstractPureEnv
from maesn.envs.tasks import TaskSet
from maesn.worlds.base import AbstractWorld, Act, Actors, Decision, Moment, Start, Trajectory


class DeviceWorld(AbstractWorld):
    """Plays an `AbstractPureEnv` on whatever device JAX uses."""

    def __init__(self, env: AbstractPureEnv[Any], tasks: TaskSet) -> None:
        self._env = env
        self._tasks = tasks

    @property
    def env(self) -> AbstractPureEnv[Any]:
        return self._env

    @property
    def tasks(self) -> TaskSet:
        return self._tasks

    def play(self, act: Act, actors: Actors, start: Start, carry: Carry) -> Trajectory:
        """See `AbstractWorld.play`. Nothing in here can fail: JAX raises no numerical errors."""
        return _scan_episodes(self._env, act, actors, start, carry)


@partial(jax.jit, static_argnums=(0, 1))
def _scan_episodes(
    env: AbstractPureEnv[Any], act: Act, actors: Actors, start: Start, carry: Carry
) -> Trajectory:
    first: Readings = {"qpos": start.qpos, "qvel": start.qvel}
    no_action = jnp.zeros((*actors.context.shape[:2], env.action_size))
    advance = jax.vmap(env.advance)

    def step(moment: Moment, _: None) -> tuple[Moment, tuple[Readings, Decision]]:
        decision = act(actors, moment)
        readings = advance(cast(Readings, moment.readings), decision.control)
        following = Moment(
            step=moment.step + 1,
            readings=readings,
            previous_readings=moment.readings,
            previous_action=decision.action,
            carry=decision.carry,
        )
        return following, (readings, decision._replace(carry=None))

    moment = Moment(jnp.zeros((), int), first, first, no_action, carry)
    last, (readings, decisions) = jax.lax.scan(step, moment, length=env.horizon)
    return Trajectory(
        readings=jax.tree.map(lambda x, xs: jnp.concatenate([x[None], xs]), first, readings),
        action=decisions.action,
        behaviour=decisions.behaviour,
        carry=last.carry,
    )
