"""Wrappers of rules: fine-tuning of the policy's weights, and a bonus on the rewards."""

from typing import Any

from maesn.envs import AnyEnv
from maesn.learners import (
    LEAST_BATCH,
    TRPO,
    AbstractFastLearner,
    CuriosityBonus,
    PolicyImprovement,
    fine_tuned,
    with_curiosity,
)
from maesn.rules.base import AbstractWrapper
from maesn.settings import check_number


class ThenTrpo(AbstractWrapper):
    """After some episodes, fix the contexts and improve the policy's weights by TRPO.

    The paper's claim about asymptotic performance is about MAESN followed by TRPO.
    """

    max_kl: float = TRPO.trust_region.max_kl
    """Bound on the mean KL divergence of an update."""
    after: int = 500
    """Episodes per task that the rule itself learns from."""

    def __check_init__(self) -> None:
        check_number("after", self.after, 0)

    @property
    def label(self) -> str:
        return f"{self.after} episodes, then TRPO"

    def check_budget(self, episodes: int, episodes_per_update: int) -> None:
        least = LEAST_BATCH
        if self.after + least > episodes:
            raise ValueError(
                f"`episodes` must be at least {least} more than `after`, got {episodes} and "
                f"{self.after}: a step of the weights learns from so many."
            )
        if self.after % episodes_per_update:
            raise ValueError(
                "`after` must be a multiple of `episodes_per_update`, got "
                f"{self.after} and {episodes_per_update}."
            )

    def wrap(self, learner: AbstractFastLearner[Any], env: AnyEnv) -> AbstractFastLearner[Any]:
        return fine_tuned(learner, PolicyImprovement(TRPO.sized(self.max_kl)), self.after)


class VimeBonus(AbstractWrapper):
    """A curiosity bonus, as in VIME."""

    label = "bonus by VIME"

    curiosity: CuriosityBonus = CuriosityBonus()
    """Settings of the bonus."""

    def wrap(self, learner: AbstractFastLearner[Any], env: AnyEnv) -> AbstractFastLearner[Any]:
        return with_curiosity(learner, self.curiosity, env.observation_size, env.action_size)
