"""First-order optimisation on minibatches: Adam by Optax."""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from maesn.numerics.first_order import first_order_step
from maesn.settings import check_least, check_positive

Parameters = TypeVar("Parameters")
Auxiliary = TypeVar("Auxiliary")


class MinibatchDescent(eqx.Module):
    """Goes through the same data several times, in minibatches that are drawn anew each time.

    Gradients are cut to a largest norm and followed by Adam (Kingma and Ba 2015,
    https://arxiv.org/abs/1412.6980).
    """

    learning_rate: float = 1e-3
    """Learning rate of Adam."""
    epochs: int = 2
    """Passes over the data."""
    minibatches: int = 8
    """Steps per pass. What does not divide evenly is left out of a pass, each time another part."""
    max_gradient_norm: float = 0.5
    """Longer gradients are shortened to this norm."""

    def __check_init__(self) -> None:
        check_positive(self, "learning_rate")
        if not self.max_gradient_norm > 0:  # infinite: no gradient is shortened
            raise ValueError(f"`max_gradient_norm` must be positive, got {self.max_gradient_norm}.")
        check_least(self, epochs=1, minibatches=1)

    def init(self, parameters: Any) -> optax.OptState:
        """Return the optimiser's state before the first step."""
        return self._transformation().init(parameters)

    def run(
        self,
        key: PRNGKeyArray,
        parameters: Parameters,
        opt_state: optax.OptState,
        loss: Callable[[Parameters, Any], tuple[Float[Array, ""], Auxiliary]],
        data: Any,
    ) -> tuple[Parameters, optax.OptState, Auxiliary]:
        """Return improved parameters, the optimiser's state, and the last pass's mean extras.

        Args:
            key: draws the minibatches.
            parameters: the parameters before the first step.
            opt_state: the result of `init` or of an earlier run.
            loss: of parameters and a minibatch; returns extras beside it.
            data: a pytree whose arrays have a common leading axis of samples.

        Raises:
            ValueError: there are fewer samples than minibatches.
        """
        samples = jax.tree.leaves(data)[0].shape[0]
        size = samples // self.minibatches
        if size == 0:
            raise ValueError(
                f"`minibatches` is {self.minibatches}, but there are only {samples} samples: "
                "lower it, or play more."
            )
        gradient = jax.grad(loss, has_aux=True)
        transformation = self._transformation()

        def step(
            now: tuple[Parameters, optax.OptState], rows: Array
        ) -> tuple[tuple[Parameters, optax.OptState], Auxiliary]:
            varied, opt_state = now
            slopes, extras = gradient(varied, jax.tree.map(lambda x: x[rows], data))
            return first_order_step(transformation, varied, slopes, opt_state), extras

        def shuffled(epoch_key: PRNGKeyArray) -> Array:
            order = jax.random.permutation(epoch_key, samples)[: size * self.minibatches]
            return order.reshape(self.minibatches, size)

        rows = jax.vmap(shuffled)(jax.random.split(key, self.epochs))
        (parameters, opt_state), extras = jax.lax.scan(
            step, (parameters, opt_state), rows.reshape(-1, size)
        )
        last = jax.tree.map(lambda x: jnp.mean(x[-self.minibatches :], axis=0), extras)
        return parameters, opt_state, last

    def _transformation(self) -> optax.GradientTransformation:
        return optax.chain(
            optax.clip_by_global_norm(self.max_gradient_norm), optax.adam(self.learning_rate)
        )
