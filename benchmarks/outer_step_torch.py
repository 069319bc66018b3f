"""An outer step of pytorch-maml-rl; `outer_step_peers.py` runs this file there."""

import asyncio
from collections.abc import Callable
from typing import Any

import maml_rl
import numpy as np
import torch
from maml_rl.episode import BatchEpisodes
from maml_rl.metalearners import MAMLTRPO
from maml_rl.policies import NormalMLPPolicy
from outer_step_theirs import CG_STEPS, INNER_STEP, LAYERS, Batch, print_row


def played(loop: asyncio.AbstractEventLoop, batch: Batch, task: int) -> asyncio.Future[Any]:
    """Return the episodes of a task as what its samplers return.

    The baseline is zero: its linear one needs a function that PyTorch has removed.
    """
    arrays = (batch[name][task] for name in ("observation", "action", "reward"))
    by_time = [np.ascontiguousarray(array.swapaxes(0, 1)) for array in arrays]
    episodes = BatchEpisodes(by_time[0].shape[1])
    for now in zip(*by_time, strict=True):
        episodes.append(*now, range(episodes.batch_size))
    episodes.compute_advantages(lambda one: torch.zeros_like(one.rewards))
    future = loop.create_future()
    future.set_result(episodes)
    return future


def step_of(pre: Batch, post: Batch) -> Callable[[], Any]:
    """Return the step."""
    loop = asyncio.new_event_loop()
    asyncio.set_event_loop(loop)
    sizes = (pre[name].shape[-1] for name in ("observation", "action"))
    policy = NormalMLPPolicy(*sizes, hidden_sizes=LAYERS, nonlinearity=torch.tanh)
    learner = MAMLTRPO(policy, fast_lr=INNER_STEP)
    before, after = (
        [played(loop, batch, task) for task in range(len(batch["reward"]))] for batch in (pre, post)
    )
    return lambda: learner.step([before], after, cg_iters=CG_STEPS, ls_max_steps=1)


if __name__ == "__main__":
    print_row(maml_rl, "torch", step_of)
