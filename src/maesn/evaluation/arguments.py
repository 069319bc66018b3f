"""Types of the arguments of `maesn.adapt` and its like, and how the command line reads them."""

from pathlib import Path
from typing import Annotated, Any, TypeAlias

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from maesn.envs import TaskFamily
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.naming import bonus_from_text, rule_from_text, then_from_text
from maesn.runs.run import Run


def _word(metavar: str) -> PrimitiveConstructorSpec[Any]:
    """Say that an argument is one word of the command line."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: words[0],
        is_instance=lambda _: True,
        str_from_instance=lambda value: [str(value)],
    )


AnyRun: TypeAlias = Annotated[str | Path | Run, _word("RUN")]
"""A run, its directory, or the name of a policy that comes with the library."""
AnyPath: TypeAlias = Annotated[str | Path, _word("PATH")]
OptionalPath: TypeAlias = Annotated[str | Path | None, _word("PATH")]
AnyFamily: TypeAlias = Annotated[str | TaskFamily | None, _word("MODULE:NAME")]
"""A user's own family or its `module:name`; None for one that comes with the library."""


def evaluation_from_text(
    evaluation: Annotated[Evaluation, tyro.conf.arg(name="")],
    rule: tuple[str, ...] = (),
    then: tuple[str, ...] = (),
    bonus: tuple[str, ...] = (),
) -> Evaluation:
    """Return an evaluation with rule and wrappers that are given as words.

    Args:
        evaluation: all else of it.
        rule: What happens in a new task: gradient, memory or none, or `module:name` of your own;
            behind it its settings, as in `--rule gradient step_scale=2`. Left out: what the method
            prescribes. `maesn list` has all settings.
        then: How the policy's weights go on after some episodes: trpo or reinforce, as in `--then
            trpo after=500 max_kl=0.01`. Left out: they stay.
        bonus: A bonus on the rewards that are learned from, as in `--bonus vime
            curiosity.weight=0.001`.

    Raises:
        RunError: a rule cannot be had, or not with these budgets.
    """
    wrappers = [then_from_text(" ".join(then))] if then else []
    wrappers += [bonus_from_text(" ".join(bonus))] if bonus else []
    chosen = rule_from_text(" ".join(rule)) if rule else None
    return evaluation.changed(rule=chosen, wrappers=tuple(wrappers))


AnyEvaluation: TypeAlias = Annotated[
    Evaluation, tyro.conf.arg(name="", constructor=evaluation_from_text)
]
