"""HyperX: a bonus for what is new to an agent that does not know its task.

Zintgraf et al. 2021, https://arxiv.org/abs/2010.01062, section 4. The bonus of a step is

    r^+ = s_r [ w_n n / s_n + w_e e / s_e ] · max(0, 1 - iteration / last_iteration)

with the novelty n = mean_j (f_j - g_j)² of observation and belief after the step, where f is a
fixed random network and g learns to predict it (random network distillation, Burda et al. 2018,
https://arxiv.org/abs/1810.12894), and the error e = -log p(r, o' | m), m from the belief after the
step. Standard deviations of discounted returns, over all training so far, make the weights numbers
without a unit.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import Key
from maesn.learners.trial_value import mean_and_std, moments_of
from maesn.networks import MLP, init_mlp
from maesn.numerics import discounted_returns, first_order_step
from maesn.settings import check_least, check_positive, check_sizes


class BonusState(eqx.Module):
    """State of a `HyperBonus`."""

    target: MLP
    """f, which never changes."""
    predictor: MLP
    """g."""
    opt_state: Any
    """State of Adam."""
    moments: Float[Array, "3 3"]
    """Sums over the iterations so far: 1, mean and mean square of the discounted returns of reward,
    novelty and error."""


class HyperBonus(eqx.Module):
    """Settings of the bonus."""

    novelty_weight: float = 0.0
    """w_n. Reference: 0 in VariBAD; 0.01 in HyperX on point goals."""
    error_weight: float = 0.0
    """w_e. Reference: 0 in VariBAD; 0.1 in HyperX on point goals."""
    last_iteration: int = 1000
    """Meta-iteration from which on there is no bonus. Reference: the last one of the training."""
    hidden_sizes: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of f and g. Reference: two layers of 256."""
    output_size: int = 32
    """Components of f. Reference: 128."""
    input_scale: float = 10.0
    """Factor on the first weights of f: the larger, the finer it tells inputs apart. (Reference: 10
    on all of its weights.)"""
    learning_rate: float = 1e-4
    """Learning rate of g. Reference: 1e-4."""
    batch_size: int = 128
    """Steps of a gradient step of g. Reference: 128."""
    updates: int = 4
    """Gradient steps of a meta-iteration. (Reference: 1 after 9,600 environment steps.)"""

    def __check_init__(self) -> None:
        check_least(
            self,
            last_iteration=1,
            output_size=1,
            batch_size=1,
            updates=1,
            novelty_weight=0,
            error_weight=0,
        )
        check_positive(self, "input_scale", "learning_rate")
        check_sizes(self, "hidden_sizes")

    def init(self, key: Key, features: int) -> BonusState | None:
        """Return the state before training, for inputs of so many components; None for no bonus."""
        if self.novelty_weight == self.error_weight == 0:
            return None
        target_key, predictor_key = jax.random.split(key)
        sizes = (features, *self.hidden_sizes, self.output_size)
        target = init_mlp(target_key, sizes).scaled(0, self.input_scale)
        predictor = init_mlp(predictor_key, sizes)
        opt_state = optax.adam(self.learning_rate).init(predictor)
        return BonusState(target, predictor, opt_state, jnp.zeros((3, 3)))

    def judge(
        self,
        state: BonusState,
        iteration: Int[Array, ""],
        seen: Float[Array, "trial time feature"],
        error: Float[Array, "trial time"],
        reward: Float[Array, "trial time"],
        valid: Bool[Array, "trial time"],
        discount: float,
    ) -> tuple[Float[Array, "trial time"], BonusState]:
        """Return the bonus of every step, 0 where invalid, and the state with its moments.

        Args:
            state: the networks.
            iteration: meta-iterations that are done.
            seen: observation and belief after each step.
            error: e.
            reward: rewards of the steps, in whose returns' unit the bonus is.
            valid: which steps count.
            discount: gamma.
        """
        novelty = jax.vmap(jax.vmap(lambda x: _mismatch(state.predictor, state.target, x)))(seen)
        returns = jax.vmap(discounted_returns, in_axes=(0, 0, None))
        streams = (reward, novelty, error)
        # Of all batches so far: scales that forget would make the familiar new again.
        batch = [moments_of(returns(stream, valid, discount), valid) for stream in streams]
        moments = state.moments + jnp.stack(batch)
        reward_std, novelty_std, error_std = (mean_and_std(one)[1] for one in moments)
        weighted = (
            self.novelty_weight * novelty / novelty_std + self.error_weight * error / error_std
        )
        left = jnp.maximum(1.0 - iteration.astype(float) / self.last_iteration, 0.0)
        bonus = jnp.where(valid, left * reward_std * weighted, 0.0)
        return bonus, eqx.tree_at(lambda one: one.moments, state, moments)

    def learn(
        self,
        key: Key,
        state: BonusState,
        seen: Float[Array, "trial time feature"],
        valid: Bool[Array, "trial time"],
    ) -> BonusState:
        """Return the state after g has learned from some of the steps."""
        adam = optax.adam(self.learning_rate)
        rows, chances = seen.reshape(-1, seen.shape[-1]), jnp.where(valid.ravel(), 0.0, -jnp.inf)

        def update(now: tuple[MLP, Any], update_key: Key) -> tuple[tuple[MLP, Any], None]:
            predictor, opt_state = now
            drawn = rows[jax.random.categorical(update_key, chances, shape=(self.batch_size,))]

            def loss(predictor: MLP) -> Float[Array, ""]:
                return jax.vmap(lambda x: _mismatch(predictor, state.target, x))(drawn).mean()

            return first_order_step(adam, predictor, jax.grad(loss)(predictor), opt_state), None

        keys = jax.random.split(key, self.updates)
        (predictor, opt_state), _ = jax.lax.scan(update, (state.predictor, state.opt_state), keys)
        return BonusState(state.target, predictor, opt_state, state.moments)


def _mismatch(predictor: MLP, target: MLP, x: Float[Array, " feature"]) -> Float[Array, ""]:
    return jnp.mean((target(x) - predictor(x)) ** 2)
