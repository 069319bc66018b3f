"""Where the random draws of a run come from, and the state that training begins with."""

import warnings
from typing import Any

import equinox as eqx
import jax
import numpy as np

from maesn.axes import Key
from maesn.envs import AnyEnv, TaskFamily, TaskSet
from maesn.learners import AbstractMetaLearner, method_name
from maesn.policies import USUAL, AbstractPolicy
from maesn.storage import RunError, refusals

# An "iteration" that no run reaches: its key makes the untrained state. Splitting the seed's key
# instead would yield the keys of iterations 0 and 1 a second time.
_UNTRAINED = 0xFFFFFFFF


def iteration_key(seed: int, iteration: int) -> Key:
    """Return the key that all draws of one iteration, 0 to 2^32 - 2, derive from."""
    return jax.random.fold_in(jax.random.key(seed), np.uint32(iteration))


def untrained_state(
    learner: AbstractMetaLearner[Any, Any],
    env: AnyEnv,
    seed: int,
    num_tasks: int,
    description_size: int,
) -> Any:
    """Return the state that the seed says."""
    key = iteration_key(seed, _UNTRAINED)
    sizes = (env.observation_size, env.action_size, num_tasks, description_size)
    return _init(learner, key, *sizes)


@eqx.filter_jit  # one program instead of many small ones takes half the time to compile
def _init(learner: AbstractMetaLearner[Any, Any], key: Key, *sizes: int) -> Any:
    return learner.init(key, *sizes)


def check_policy(learner: AbstractMetaLearner[Any, Any], state: Any, env: AnyEnv) -> None:
    """Refuse policies that cannot play in an environment.

    Raises:
        RunError: their actions are of another kind, or they read a reward that is not there.
    """
    policy = learner.player(state)
    check_shown(policy, env)
    wanted, kind = env.action_kind, policy.action_kind
    if kind != wanted:
        method, usual = method_name(learner), type(USUAL[wanted]).__name__
        raise RunError(
            f"`{env.name}` needs a policy of {wanted} actions, but that of `{method}` chooses "
            f"{kind} ones: give the learner another, as in "
            f'maesn.PRESETS["maesn"](policy=maesn.{usual}()); for `rl2` and its like, '
            f'maesn.Recurrent(action_kind="{wanted}").'
        )


def check_shown(policy: AbstractPolicy, env: AnyEnv) -> None:
    """Refuse a policy that reads a reward which the environment cannot show.

    Raises:
        RunError: it does.
    """
    with refusals():
        env.check_shown(policy.observed_reward)


def warn_of_known_tests(family: TaskFamily, tasks: TaskSet) -> None:
    """Say so if the test tasks are those of training, as where `draw_tasks` ignores its stream."""
    if family.task_set("test").digest() == tasks.digest():
        warnings.warn(
            f"the test tasks of `{family.name}` are those that are trained on: `draw_tasks` draws "
            "the same whatever its stream, so a result on them says nothing of new tasks.",
            stacklevel=3,
        )
