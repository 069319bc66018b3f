"""The state that training begins with: drawn from a seed, with or without another run's weights."""

from typing import Any

import equinox as eqx
import jax

from maesn.axes import Key
from maesn.learners import AbstractMetaLearner, Problem
from maesn.runs.checkpoint import named_leaves, names_of, restore
from maesn.storage import RunError

LARGEST_REPLAY = 200  # megabytes, in memory and on disk


@eqx.filter_jit  # one program instead of many small ones takes half the time to compile
def drawn_state(learner: AbstractMetaLearner[Any, Any], key: Key, problem: Problem) -> Any:
    """Return the state before any training."""
    return learner.init(key, problem)


@eqx.filter_jit  # which leaves out the networks
def drawn_replay(learner: AbstractMetaLearner[Any, Any], key: Key, problem: Problem) -> Any:
    """Return the replay before any training."""
    return learner.replay(learner.init(key, problem))


def with_weights_of(
    other: Any, fresh: Any, larger: Any, learner: AbstractMetaLearner[Any, Any], source: Any
) -> Any:
    """Return a fresh state with the weights of another one that tasks share.

    `larger` is the structure of a state for one more task: what differs in shape belongs to tasks.
    Messages call the other state by its source; `RunError` if the weights do not fit.
    """
    learned, values, shapes = map(named_leaves, (other, fresh, larger))
    for name in names_of(learner.weights(fresh), fresh):
        if values[name].shape == shapes[name].shape:  # what belongs to a task begins afresh
            values[name] = learned.get(name)
    return restore(fresh, values, source)


def check_replay(learner: AbstractMetaLearner[Any, Any], state: Any, method: str) -> None:
    """Refuse by `RunError` a replay that is too large to keep."""
    megabytes = sum(x.nbytes for x in jax.tree.leaves(learner.replay(state))) / 1e6
    if megabytes > LARGEST_REPLAY:
        raise RunError(
            f"the replay of `{method}` takes {megabytes:.0f} MB; at most {LARGEST_REPLAY} MB are "
            "kept: let it hold fewer episodes, or train smaller networks."
        )
