"""What is checked before a policy plays, and before a run begins; refusals are `RunError`s."""

import warnings
from pathlib import Path
from typing import Any

from maesn.envs import AnyEnv, TaskFamily, TaskSet
from maesn.learners import AbstractMetaLearner, method_name
from maesn.policies import USUAL
from maesn.storage import RunError, refusals


def check_policy(learner: AbstractMetaLearner[Any, Any], state: Any, env: AnyEnv) -> None:
    """Refuse policies whose actions are of another kind, or that read a reward that is lacking."""
    policy = learner.player(state)
    with refusals():
        env.check_shown(policy.observed_reward)
    wanted, kind = env.action_kind, policy.action_kind
    if kind != wanted:
        method, usual = method_name(learner), type(USUAL[wanted]).__name__
        raise RunError(
            f"`{env.name}` needs a policy of {wanted} actions, but that of `{method}` chooses "
            f"{kind} ones: give the learner another, as in "
            f'maesn.PRESETS["maesn"](policy=maesn.{usual}()); for `rl2` and its like, '
            f'maesn.Recurrent(action_kind="{wanted}").'
        )


def check_sizes(directory: Path, trained: AnyEnv, env: AnyEnv, remedy: str) -> None:
    """Refuse an environment whose observations or actions have other sizes than a run's own."""
    for name in ("observation_size", "action_size"):
        wanted, found = getattr(env, name), getattr(trained, name)
        if wanted != found:
            raise RunError(
                f"`{directory}` must have an environment of `{name}` {wanted}, as this "
                f"`{env.name}` of variant `{env.variant}` has, got {found}: {remedy}."
            )


def warn_of_known_tests(family: TaskFamily, tasks: TaskSet) -> None:
    """Say so if the test tasks are those of training, as where `draw_tasks` ignores its stream."""
    if family.task_set("test").digest() == tasks.digest():
        warnings.warn(
            f"the test tasks of `{family.name}` are those that are trained on: `draw_tasks` draws "
            "the same whatever its stream, so a result on them says nothing of new tasks.",
            stacklevel=3,
        )
