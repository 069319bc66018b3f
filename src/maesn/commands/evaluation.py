"""The options by which commands are given an `Evaluation`."""

import dataclasses
from typing import Annotated

import tyro

from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.naming import bonus_from_text, rule_from_text, then_from_text
from maesn.storage import refusals


@dataclasses.dataclass(frozen=True)
class EvaluationOptions:
    """An evaluation, with its rule as text."""

    evaluation: Annotated[Evaluation, tyro.conf.arg(name="")] = Evaluation()
    rule: tuple[str, ...] = ()
    """What happens in a new task: gradient, memory or none, or `module:name` of your own; behind it
    its settings, as in `--rule gradient step_scale=2`. Left out: what the method prescribes. `maesn
    list` has all settings."""
    then: tuple[str, ...] = ()
    """How the policy's weights go on after some episodes: trpo or reinforce, as in `--then trpo
    after=500 max_kl=0.01`. Left out: they stay."""
    bonus: tuple[str, ...] = ()
    """A bonus on the rewards that are learned from, as in `--bonus vime curiosity.weight=0.001`."""

    def build(self) -> Evaluation:
        """Return the evaluation.

        Raises:
            RunError: a rule cannot be had, or not with these budgets.
        """
        rule = rule_from_text(" ".join(self.rule)) if self.rule else None
        wrappers = [then_from_text(" ".join(self.then))] if self.then else []
        wrappers += [bonus_from_text(" ".join(self.bonus))] if self.bonus else []
        with refusals():
            return dataclasses.replace(self.evaluation, rule=rule, wrappers=tuple(wrappers))
