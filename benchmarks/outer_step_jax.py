"""An outer step of metaworld-algorithms; `outer_step_peers.py` runs this file there."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import gymnasium
import jax
import metaworld_algorithms
import numpy as np
from metaworld_algorithms.config.networks import ContinuousActionPolicyConfig
from metaworld_algorithms.config.nn import VanillaNetworkConfig
from metaworld_algorithms.config.utils import Activation, StdType
from metaworld_algorithms.rl.algorithms.mamltrpo import MAMLTRPO, MAMLTRPOConfig
from metaworld_algorithms.types import Rollout
from outer_step_theirs import CG_STEPS, INNER_STEP, LAYERS, Batch, print_row


def rollouts(batch: Batch) -> Rollout:
    """Return the episodes of all tasks as it has them: `[task, all steps, ...]`."""
    flat = {
        name: values.reshape(len(values), values.shape[1] * values.shape[2], -1)
        for name, values in batch.items()
    }
    return Rollout(
        observations=flat["observation"],
        actions=flat["action"],
        rewards=flat["reward"],
        dones=np.zeros_like(flat["reward"]),
        log_probs=flat["log_prob"],
        means=flat["mean"],
        stds=flat["std"],
        advantages=flat["advantage"],
    )


def step_of(pre: Batch, post: Batch) -> Callable[[], Any]:
    """Return the step."""
    network = VanillaNetworkConfig(width=LAYERS[0], depth=len(LAYERS), activation=Activation.Tanh)
    config = MAMLTRPOConfig(
        num_tasks=len(pre["reward"]),
        meta_batch_size=len(pre["reward"]),
        policy_config=ContinuousActionPolicyConfig(
            network, squash_tanh=False, std_type=StdType.PARAM
        ),
        policy_inner_lr=INNER_STEP,
        cg_iters=CG_STEPS,
        max_backtrack_iters=1,
    )
    spaces = {
        f"{name}_space": gymnasium.spaces.Box(-1, 1, pre[name].shape[-1:])
        for name in ("observation", "action")
    }
    learner = MAMLTRPO.initialize(config, SimpleNamespace(**spaces)).init_ensemble_networks()
    both = [rollouts(batch) for batch in (pre, post)]
    return lambda: jax.block_until_ready(learner.outer_step(both))


if __name__ == "__main__":
    print_row(metaworld_algorithms, "jax", step_of)
