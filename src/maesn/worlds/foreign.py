"""Steps environments of others, which run in processes of their own."""

import contextlib
import weakref
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt8, UInt32

from maesn.axes import HostReadings
from maesn.envs.hosted import AbstractGymnasiumEnv, as_given, task_row
from maesn.foreign import WorkerError, WorkerPool, pack_task
from maesn.physics import offscreen_library
from maesn.worlds.base import EnvContractError
from maesn.worlds.budget import num_cpus
from maesn.worlds.stepping import AbstractStepper, Controls, Ended, Renderer


class HostedStepper(AbstractStepper):
    """Steps an `AbstractGymnasiumEnv` in worker processes, which start when first needed.

    There are at most `num_workers`; 0 means one for each CPU.
    """

    def __init__(self, env: AbstractGymnasiumEnv, num_workers: int = 0) -> None:
        self.max_simulations = env.recipe.max_environments
        self._env = env
        self._num_workers = num_workers or num_cpus()
        self._pool: WorkerPool | None = None

    def begin(self, start: UInt32[Array | np.ndarray, " simulation"], tasks: Any) -> HostReadings:
        host = jax.device_get(tasks)
        packed = [pack_task(task_row(host, i)) for i in range(len(jax.tree.leaves(host)[0]))]
        each = len(start) // len(packed)
        seeds = np.asarray(start).tolist()
        return self._open().begin([task for task in packed for _ in range(each)], seeds)

    def step(self, control: Controls, ended: Ended) -> HostReadings:
        return self._open().step(control)

    def renderer(self, task: Any) -> Renderer | None:
        """None unless `make_env` has set `render_mode="rgb_array"`."""
        return self._pictures if self._open().renders(pack_task(as_given(task))) else None

    def _pictures(self, count: int) -> list[UInt8[np.ndarray, "height width 3"]]:
        return self._open().pictures(count, offscreen_library())

    def close(self) -> None:
        if self._pool is not None:
            self._pool.close()
            self._pool = None

    def _open(self) -> WorkerPool:
        if self._pool is None:
            self._pool = self._env.open_pool(self._num_workers)
            # Also at the end of the program.
            weakref.finalize(self, self._pool.close)
        return self._pool


def check_hosted(env: AbstractGymnasiumEnv, task: Any) -> None:
    """Begin and step an environment once.

    Raises:
        EnvContractError: it fails, or returns what cannot be used.
    """
    row = as_given(task)
    action = jnp.zeros(env.action_size)
    with contextlib.closing(env.open_pool(1)) as pool:
        try:
            first = pool.begin([pack_task(row)], [0])
            after = pool.step(np.asarray(env.control(action))[None])
        except WorkerError as error:
            raise EnvContractError(f"`{env.name}`, task 0: {error.reason}") from error
        if env.recipe.reward is not None:
            _check_reward(env, first, after, row)


def _check_reward(
    env: AbstractGymnasiumEnv, before: HostReadings, after: HostReadings, task: Any
) -> None:
    first, second = ({n: jnp.asarray(x[0]) for n, x in seen.items()} for seen in (before, after))
    own, given = second["reward"], env.reward(first, jnp.zeros(env.action_size), second, task).total
    if not jnp.isclose(given, own, rtol=1e-3, atol=1e-4):
        raise EnvContractError(
            f"`{env.name}`: `reward` must be the environment's own, {float(own):g} in the first "
            f"step, got {float(given):g}."
        )
