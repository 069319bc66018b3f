"""What can be changed about a learner in new tasks: step sizes, curiosity, fine-tuning."""

import dataclasses
import math
from typing import Any, Literal, TypeAlias

from maesn.envs import AnyEnv
from maesn.evaluation.record import written_out
from maesn.learners import (
    IMPROVEMENTS,
    AbstractFastLearner,
    BonusFastLearner,
    FineTuning,
    GradientFastLearner,
    PolicyImprovement,
    inside,
)
from maesn.learners.wrappers.curiosity import CuriosityBonus
from maesn.runs.run import Run
from maesn.runs.serialization import digest
from maesn.runs.storage import RunError
from maesn.settings import check_choice

FineTuneRule: TypeAlias = Literal["trpo", "reinforce"]


@dataclasses.dataclass(frozen=True)
class AtTestTime:
    """What is added to a learner in new tasks. By default nothing."""

    fine_tune: FineTuneRule | None = None
    """How the policy's weights go on in the updates beyond --after; None: they do not."""
    fine_tune_size: float | None = None
    """Of the updates that fine-tune: trpo's bound on the mean KL divergence, or reinforce's step
    size; None: the usual, 0.01 and 0.1."""
    after: int = 10
    """Updates of the learner before its policy is fine-tuned."""
    curious: bool = False
    """Whether the learner is paid for what it finds out as well, also when it is fine-tuned."""
    curiosity: CuriosityBonus = dataclasses.field(default_factory=CuriosityBonus)
    """What a curious learner is paid."""
    step_scale: float = 1.0
    """Multiplies the sizes of all steps of the learner's own updates."""
    full_steps: int | None = None
    """Updates with the whole step size, before the sizes begin to shrink (by `schedule.factor`,
    usually 1/2); None: as the run's settings say."""

    def __post_init__(self) -> None:
        if self.fine_tune is not None:
            check_choice("fine_tune", self.fine_tune, FineTuneRule)
        if self.fine_tune_size is not None:
            if self.fine_tune is None:
                raise ValueError("`fine_tune_size` means nothing without `fine_tune`: give both.")
            if not 0 < self.fine_tune_size < math.inf:
                raise ValueError(
                    f"`fine_tune_size` must be positive and finite, got {self.fine_tune_size}."
                )
        if self.after < 0:
            raise ValueError(f"`after` must be at least 0, got {self.after}.")
        if not 0 < self.step_scale < math.inf:
            raise ValueError(f"`step_scale` must be positive and finite, got {self.step_scale}.")
        if self.full_steps is not None and self.full_steps < 1:
            raise ValueError(f"`full_steps` must be at least 1, got {self.full_steps}.")

    def check_reached(self, updates: int) -> None:
        """Refuse a fine-tuning that would never begin.

        Args:
            updates: number of updates in the new tasks.

        Raises:
            RunError: all of them are the learner's own.
        """
        if self.fine_tune is not None and self.after >= updates:
            raise RunError(
                f"`updates` must be more than `after`, got {updates} and {self.after}: no update "
                "would be left in which the policy is fine-tuned."
            )

    @property
    def label(self) -> str:
        """What is changed, as it stands behind a method's name in figures; empty for nothing."""
        updates = "1 update" if self.after == 1 else f"{self.after} updates"
        size = "" if self.fine_tune_size is None else f" of {self.fine_tune_size:g}"
        parts = {
            f"steps × {self.step_scale:g}": self.step_scale != 1,
            f"{self.full_steps} full steps": self.full_steps is not None,
            "curious": self.curious,
            f"{updates} then {str(self.fine_tune).upper()}{size}": self.fine_tune is not None,
        }
        return "; ".join(text for text, is_so in parts.items() if is_so)

    @property
    def suffix(self) -> str:
        """What is appended to the name of a table of adaptation curves."""
        tuned = "" if self.fine_tune is None else f"-{self.after}-then-{self.fine_tune}"
        sized = "" if self.fine_tune_size is None else f"-{self.fine_tune_size}"
        # All digits, since earlier curves are recognised by this name.
        scale = str(self.step_scale).removesuffix(".0")
        scaled = "" if self.step_scale == 1 else f"-steps-x{scale}"
        paced = "" if self.full_steps is None else f"-{self.full_steps}-full-steps"
        return scaled + paced + self._curious_suffix + tuned + sized

    @property
    def written(self) -> str:
        """What is added to a learner, written out in full for the record of its curves."""
        tuned = "" if self.fine_tune is None else f" {written_out(self._improvement)}"
        curious = f" {written_out(self.curiosity)}" if self.curious else ""
        return self.suffix + tuned + curious

    @property
    def _improvement(self) -> PolicyImprovement:
        """How the weights go on."""
        assert self.fine_tune is not None
        usual = IMPROVEMENTS[self.fine_tune]
        if self.fine_tune_size is None:
            return usual
        return dataclasses.replace(usual, rule=usual.rule.sized(self.fine_tune_size))

    @property
    def _curious_suffix(self) -> str:
        if not self.curious:
            return ""
        return (
            "-curious"
            if self.curiosity == CuriosityBonus()
            else f"-curious-{digest(self.curiosity)}"
        )

    def add_to(
        self,
        learner: AbstractFastLearner[Any],
        run: Run,
        env: AnyEnv,
        episodes_per_update: int = 50,
    ) -> AbstractFastLearner[Any]:
        """Return the learner of a run with all that is to be added.

        Raises:
            RunError: the learner cannot be given that.
        """
        if self.curious and learner.capabilities.has_bonus:
            raise RunError(
                f"`curious` cannot be given to a run of {run.settings.method}, which is curious "
                "already: leave it out."
            )
        try:
            return self._changed(learner, env, episodes_per_update)
        except ValueError as error:
            raise RunError(
                f"`{run.settings.method}` cannot be adapted like this: {error}"
            ) from error

    def _changed(
        self, learner: AbstractFastLearner[Any], env: AnyEnv, episodes_per_update: int
    ) -> AbstractFastLearner[Any]:
        if self.step_scale != 1 or self.full_steps is not None:
            learner = inside(learner, self._paced)
        if self.fine_tune is not None:
            after = self.after * episodes_per_update
            learner = inside(learner, lambda one: FineTuning(one, self._improvement, after))
        if self.curious:
            sizes = env.observation_size, env.action_size
            learner = BonusFastLearner(learner, self.curiosity, *sizes)
        return learner

    def _paced(self, learner: AbstractFastLearner[Any]) -> AbstractFastLearner[Any]:
        if not isinstance(learner, GradientFastLearner):
            raise ValueError(f"`{type(learner).__name__}` follows no schedule of step sizes.")
        if not learner.capabilities.learns_from_reward:
            raise ValueError("it changes nothing in a task, so it takes no steps.")
        schedule = learner.schedule
        full_steps = schedule.full_steps if self.full_steps is None else self.full_steps
        scale = schedule.scale * self.step_scale
        changed = dataclasses.replace(schedule, scale=scale, full_steps=full_steps)
        return dataclasses.replace(learner, schedule=changed)


NOTHING_ADDED = AtTestTime()
