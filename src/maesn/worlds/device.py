"""Worlds moved by JAX: a whole batch of episodes is one compiled scan."""

from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from maesn.axes import Readings
from maesn.envs.base import AbstractPureEnv, AnyEnv, Start
from maesn.envs.tasks import TaskSet
from maesn.worlds.base import AbstractWorld, Act, Actors, Decision, Moment, Trajectory


@runtime_checkable
class Advance(Protocol):
    """Moves all simulations by one control step. Equal objects share a compiled program."""

    def __call__(
        self,
        state: Any,
        control: Float[Array, "simulation control"],
        ended: Bool[Array, " simulation"],
    ) -> tuple[Any, Readings]:
        """Return the states one control step later, and their readings."""


class DeviceWorld(AbstractWorld):
    """Plays an `AbstractPureEnv` on JAX's device, which manages its own threads."""

    env: AbstractPureEnv[Any]

    def __init__(self, env: AbstractPureEnv[Any], tasks: TaskSet, num_threads: int = 0) -> None:
        self.env = env
        self.tasks = tasks

    def play(self, act: Act, actors: Actors, start: Start) -> Trajectory:
        """It cannot fail: JAX raises no numerical errors."""
        first: Readings = {"qpos": start.qpos, "qvel": start.qvel}
        advance = _PureAdvance(self.env)
        return scan_episodes(self.env, advance, act, actors, first, first)[0]

    def close(self) -> None:
        """Do nothing: there are no threads or processes but JAX's own."""


class _PureAdvance(NamedTuple):
    """`Advance` of an environment whose readings are its whole state."""

    env: AbstractPureEnv[Any]

    def __call__(
        self,
        state: Readings,
        control: Float[Array, "simulation control"],
        ended: Bool[Array, " simulation"],
    ) -> tuple[Readings, Readings]:
        readings = jax.vmap(self.env.advance)(state, control)
        return readings, readings


@partial(jax.jit, static_argnums=(0, 1, 2))
def scan_episodes(
    env: AnyEnv, advance: Advance, act: Act, actors: Actors, state: Any, first: Readings
) -> tuple[Trajectory, Bool[Array, "time task episode"]]:
    """Play one episode of `env.horizon` steps in every simulation, in one compiled program.

    `first` are the readings of the initial state, which is as `advance` takes it. Returns the
    trajectory, and which episodes had ended at each decision.
    """
    batch = actors.z.shape[:2]
    no_action, no_end = jnp.zeros((*batch, env.action_size)), jnp.zeros(batch, bool)

    def step(now: tuple[Any, Moment], _: None) -> tuple[Any, tuple[Readings, Decision]]:
        state, moment = now
        decision = act(actors, moment)
        state, readings = advance(state, jnp.asarray(decision.control), decision.ended.reshape(-1))
        following = Moment(
            step=moment.step + 1,
            readings=readings,
            previous_readings=moment.readings,
            previous_action=decision.action,
            recurrent_state=decision.recurrent_state,
            ended=decision.ended,
        )
        return (state, following), (readings, decision._replace(recurrent_state=None))

    recurrent_state = actors.trial_state.recurrent_state
    moment = Moment(jnp.zeros((), int), first, first, no_action, recurrent_state, no_end)
    (_, last), (readings, decisions) = jax.lax.scan(step, (state, moment), length=env.horizon)
    trajectory = Trajectory(
        readings=jax.tree.map(lambda x, xs: jnp.concatenate([x[None], xs]), first, readings),
        action=decisions.action,
        behaviour=decisions.behaviour,
        recurrent_state=last.recurrent_state,
    )
    return trajectory, decisions.ended
