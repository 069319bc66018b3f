"""What is done in new tasks: which tasks, under which rule, for how many episodes."""

import dataclasses
from collections.abc import Sequence, Sized
from typing import Annotated, Any, TypeAlias

import tyro

from maesn.envs import AnyEnv, RewardKind
from maesn.evaluation.arguments import AnyRule, AnyWrappers
from maesn.evaluation.protocols import PROTOCOLS, ProtocolName, check_protocol, settings_by
from maesn.learners import AbstractFastLearner
from maesn.rules import AbstractRule, AbstractWrapper, Budget, Trained, written_out
from maesn.serialization import digest_of_document
from maesn.settings import check_choice, check_numbers
from maesn.storage import RunError, refusals

TASKS_AT_ONCE = 25  # at most, unless asked for: more are no faster on two cores


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Adaptation to new tasks. Budgets are episodes per task, in all and for each update."""

    tasks: str = "test"
    """test (report on these), validation (choose on these), training, ood and
    ood-validation (unlike all of these), final and final-2 (for a last look, when all is chosen),
    or the path of an `.npz` file."""
    num_tasks: int | None = None
    """Number of tasks, the first ones of the set. None: all. `maesn adapt` refuses more than the
    set has; a comparison or a study then takes all."""
    reward: RewardKind = "sparse"
    """Reward in the new tasks."""
    rule: AnyRule = None
    """What happens in a new task: gradient, search, stationary (a control: a search that knows no
    training task), none, or `module:name` of your own; behind it its settings, as in
    `--rule gradient step_scale=2`. None: what the method prescribes. `maesn list` has all
    settings."""
    wrappers: AnyWrappers = ()
    """What is added to the rule, such as fine-tuning or a bonus."""
    episodes: int | None = None
    """Episodes of each task that are learned from; None: as many as the rule usually has, 500, or
    20 of a search, or 0 of `none`."""
    episodes_per_update: int | None = None
    """Episodes of each task that an update learns from; None: 50, or 1 of a search. A policy that
    remembers earlier episodes, as that of `rl2`, plays as many trials side by side, one episode of
    each between two updates."""
    deploy_episodes: int | None = None
    """Fresh episodes of each task that judge the deployed agent and are not learned from; None: 0,
    or 5 of a search, or 50 of `none`. 0: the paper's procedure, which judges by the episodes that
    are learned from."""
    deploy_after: tuple[int, ...] = ()
    """Numbers of episodes after which the deployed agent is judged; none: after every update."""
    action_noise: bool = False
    """Whether actions have the noise of training in the episodes of a search and in deployed ones.
    False: there each is the most probable one, for the latent alone explores."""
    seed: int = 0
    """Seed of the episodes."""
    sparse_radius: float | None = None
    """Radius around the goal, in metres, within which sparse reward tells the distance. None: that
    of the run."""
    num_threads: int | None = None
    """Threads of the physics engine, 0 for one for each CPU; None: as the run's settings say."""
    tasks_at_once: int | None = None
    """Tasks that advance together. Memory grows with it: 25 tasks of 50 episodes of 200 steps take
    about 100 MB. None: 25, or fewer if memory is short. What is played does not depend on it."""
    protocol: ProtocolName | None = None
    """How others evaluate: maesn, pearl, varibad or metaworld-ml1 sets tasks, reward and numbers of
    episodes, all of which are in the table's record. None: as the other settings say."""

    def __post_init__(self) -> None:
        check_choice("reward", self.reward, RewardKind)
        if not isinstance(self.rule, AbstractRule | None):
            raise ValueError(
                f"`rule` must be a rule, such as `maesn.SearchRule()`, got {self.rule!r}."
            )
        wrappers: Any = self.wrappers
        if not (
            isinstance(wrappers, tuple) and all(isinstance(x, AbstractWrapper) for x in wrappers)
        ):
            raise ValueError(
                f"`wrappers` must be a tuple of wrappers, such as `(maesn.VimeBonus(),)`, got "
                f"{wrappers!r}."
            )
        check_protocol(self.protocol, self)
        check_numbers(
            self,
            num_tasks=1,
            episodes=0,
            episodes_per_update=1,
            deploy_episodes=0,
            num_threads=0,
            tasks_at_once=1,
        )
        budget = self.budget
        if budget.episodes % budget.per_update:
            raise ValueError(
                f"`episodes` must be a multiple of `episodes_per_update`, got {budget.episodes} "
                f"and {budget.per_update}: change one of them."
            )
        self.check_reached("deploy_after", self.deploy_after)
        if self.deploy_after and not budget.deploy:
            raise ValueError("`deploy_after` needs `deploy_episodes`, which are played there.")
        for one in self._chosen:
            one.check_budget(budget.episodes, budget.per_update)

    def check_reached(self, name: str, counts: Sequence[int]) -> None:
        """Refuse by ValueError numbers of episodes after which there is no update."""
        budget = self.budget
        if not set(counts) <= set(range(0, budget.episodes + 1, budget.per_update)):
            raise ValueError(
                f"`{name}` must be numbers of episodes, multiples of `episodes_per_update`, "
                f"{budget.per_update}, from 0 to `episodes`, {budget.episodes}, got {list(counts)}."
            )

    def changed(self, **settings: Any) -> "Evaluation":
        """Return the evaluation with some settings changed; `RunError` if they cannot be.

        A protocol takes the place of defaults.
        """
        usual = {field.name: field.default for field in dataclasses.fields(self)}
        with refusals():
            asked = settings_by(settings.get("protocol")).items()
            by = {name: value for name, value in asked if getattr(self, name) == usual[name]}
            return dataclasses.replace(self, **by | settings)

    @property
    def budget(self) -> Budget:
        """The numbers of episodes, with those that the rule usually has where none are given."""
        given = (self.episodes, self.episodes_per_update, self.deploy_episodes)
        pairs = zip(self.usual_budget, given, strict=True)
        return Budget(*(usual if one is None else one for usual, one in pairs))

    @property
    def usual_budget(self) -> Budget:
        """The numbers of episodes that the rule usually has."""
        usual = AbstractRule.budget if self.rule is None else self.rule.budget
        # A wrapper may learn where the rule does not.
        return AbstractRule.budget if self.wrappers and not usual.episodes else usual

    def count(self, tasks: Sized) -> int:
        """Return how many tasks of a set are adapted to: the first ones, or all if it has fewer."""
        return len(tasks) if self.num_tasks is None else min(self.num_tasks, len(tasks))

    def check_count(self, tasks: Sized) -> None:
        """Refuse by `RunError` more tasks than a set has, unless a protocol asks for them."""
        usual = settings_by(self.protocol).get("num_tasks")
        if self.num_tasks not in (None, usual) and self.num_tasks > len(tasks):
            raise RunError(
                f"`num_tasks` must be at most {len(tasks)}, the number of `{self.tasks}` tasks, "
                f"got {self.num_tasks}."
            )

    @property
    def protocol_record(self) -> dict[str, str]:
        """Name of the protocol and the measure that it reports, for records; empty without one."""
        if self.protocol is None:
            return {}
        return {"protocol": self.protocol, "measure": PROTOCOLS[self.protocol].measure}

    @property
    def label(self) -> str:
        """What figures add to a method's name; empty for the method as it is."""
        return "; ".join(one.label for one in self._chosen if one.label)

    @property
    def suffix(self) -> str:
        """What names of files add for rule and wrappers; empty for the method as it is."""
        if not self.label:
            return ""
        words = "".join(c if c.isalnum() else " " for c in self.label.lower()).split()
        return f"-{'-'.join(words)}-{digest_of_document({'rule': self.rule_text})[:6]}"

    @property
    def rule_text(self) -> str:
        """Rule and wrappers with all their settings, for the record; empty for the method's own."""
        shown = [one for one in self._chosen if one is not self.rule or one.label]
        return " ".join(map(written_out, shown))

    @property
    def _chosen(self) -> list[AbstractRule | AbstractWrapper]:
        """Rule and wrappers, as far as they are given."""
        return [one for one in (self.rule, *self.wrappers) if one is not None]

    def fast_learner(self, trained: Trained, method: str, env: AnyEnv) -> AbstractFastLearner[Any]:
        """Return what learns in new tasks; `RunError` if `method`, rule and budgets do not fit."""
        budget = self.budget
        try:
            own = trained.fast_learner()
            learner = own if self.rule is None else self.rule.fast_learner(trained, env)
            for wrapper in self.wrappers:
                learner = wrapper.wrap(learner, env)
            if budget.episodes:
                learner.capabilities.check_episodes(budget.per_update)
        except ValueError as error:
            raise RunError(f"`{method}` cannot be adapted like this: {error}") from error
        is_trial = learner.capabilities.trial_episodes is not None
        if is_trial and budget.deploy not in (0, budget.per_update):
            remedy = f": leave out the protocol `{self.protocol}`" if self.protocol else ""
            raise RunError(
                f"`{method}` remembers earlier episodes and is judged in its trials, so "
                "`deploy_episodes` must be 0 or equal `episodes_per_update`, got "
                f"{budget.deploy} and {budget.per_update}{remedy}."
            )
        return learner


USUAL = Evaluation()
AnyEvaluation: TypeAlias = Annotated[Evaluation, tyro.conf.arg(name="")]
"""An evaluation, whose settings are options on the command line."""
