"""Which share of a recurrent network's gradient are matrix products at the full rate of a core.

    python benchmarks/recurrent.py

On `wheeled`, with 20 tasks x 20 episodes, a meta-iteration of `rl2` goes 16 times through a
minibatch of 50 trials of 400 steps for its policy, and as often for its value function. A step has
two products forwards, once more for the gradient, which keeps no gates, and three backwards.
"""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from maesn.networks.gru import GRU, init_gru

TRIALS, STEPS, INPUTS, HIDDEN = 50, 400, 15, 64
GATES = 3 * HIDDEN
REPETITIONS = 20


def main() -> None:
    """Print both rates."""
    gru = init_gru(jax.random.key(0), INPUTS, HIDDEN)
    x = jax.random.normal(jax.random.key(1), (TRIALS, STEPS, INPUTS))
    valid, start = jnp.ones((TRIALS, STEPS), bool), jnp.zeros((TRIALS, HIDDEN))

    @jax.jit
    @jax.grad
    def gradient(network: GRU) -> jax.Array:
        states, _ = jax.vmap(network.unroll)(x, valid, start)
        return (states**2).mean()

    @jax.jit
    def products(recurrent: jax.Array) -> jax.Array:
        def step(hidden: jax.Array, _: Any) -> Any:
            return hidden + (hidden @ recurrent)[:, :HIDDEN], None

        return jax.lax.scan(step, start + 1.0, length=STEPS)[0]

    inwards, onwards = (2 * TRIALS * STEPS * size * GATES for size in (INPUTS, HIDDEN))
    rate = onwards / _seconds(products, gru.recurrent / GATES)
    whole, alone = _seconds(gradient, gru), (3 * inwards + 4 * onwards) / rate
    print(f"rate of products: {rate / 1e9:.0f} GFLOP/s")
    print(f"gradient: {1000 * whole:.0f} ms, of which its products take {alone / whole:.0%}")


def _seconds(function: Callable[[Any], Any], argument: Any) -> float:
    """Return the least time of several calls: what else runs on the machine only adds."""
    jax.block_until_ready(function(argument))
    times = []
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        jax.block_until_ready(function(argument))
        times.append(time.perf_counter() - start)
    return min(times)


if __name__ == "__main__":
    main()
