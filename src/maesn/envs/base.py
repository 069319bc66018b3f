"""Environments: pure functions of one episode, and the tasks that they are asked to solve.

An environment says how an episode starts, what the agent observes, its reward, and when it ends. It
holds no state and knows no batch. Its world is moved by a physics engine (`AbstractMujocoEnv`), by
its own `advance` (`AbstractPureEnv`), or by processes in which the environments of others run
(`maesn.envs.hosted.AbstractGymnasiumEnv`).
"""

import dataclasses
from abc import abstractmethod
from typing import Any, ClassVar, Generic, Literal, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from maesn.axes import Action, ActionKind, Key, ObservedReward, Readings
from maesn.settings import check_choice, check_number

RewardKind: TypeAlias = Literal["dense", "sparse"]
"""Dense in meta-training, sparse in meta-testing (section "Comparisons")."""

Variant: TypeAlias = Literal["reference", "paper", "pearl", "varibad", "metacure"]
"""`reference` follows the code behind the published curves, `paper` the formulas as printed, the
others the code of a paper that uses the same family with other numbers. Families have some each."""

Task = TypeVar("Task")


class Reward(NamedTuple):
    """The reward of one step, in two parts."""

    goal: Float[Array, "*batch"]
    """The part that depends on the goal."""
    other: Float[Array, "*batch"]
    """The part that does not: control costs, contact costs, a survival bonus."""

    @property
    def total(self) -> Float[Array, "*batch"]:
        """The reward of the step."""
        return self.goal + self.other


class Start(NamedTuple):
    """How an episode of a simulated world begins."""

    qpos: Float[Array, "*simulation qpos"]
    qvel: Float[Array, "*simulation qvel"]
    model_fields: dict[str, Array]
    """What the task changes in the dynamics, `[*simulation, ...]` each; empty if nothing."""


class AbstractEnv(eqx.Module, Generic[Task]):
    """The world of one episode, as pure functions.

    `observe` receives no task. Only `instruction` can show a task to the agent.
    """

    name: eqx.AbstractClassVar[str]
    engine: eqx.AbstractClassVar[str]
    """What moves the world, as runs record it."""
    horizon: eqx.AbstractVar[int]
    """T, the number of control steps of an episode."""
    control_period: eqx.AbstractClassVar[float]
    """Seconds between two control steps."""
    observation_size: eqx.AbstractVar[int]
    """Components of an observation, instruction included."""
    action_size: eqx.AbstractVar[int]
    """Components of an action; if actions are discrete, the number of choices."""
    action_kind: ClassVar[ActionKind] = "continuous"
    """Discrete actions reach `control` and `reward` as one-hot vectors."""
    reward_kind: eqx.AbstractVar[RewardKind]
    sparse_radius: eqx.AbstractVar[float]
    """Radius of the goal region."""
    variant: eqx.AbstractVar[Variant]
    variants: ClassVar[tuple[str, ...]] = ("reference", "paper")
    """What `variant` can be."""
    has_one_reward: ClassVar[bool] = False
    """Whether dense and sparse reward are one, which policies see as it is."""
    defines_success: ClassVar[bool] = True
    """Whether `solved` means something; else tables, logs and figures leave success out."""
    planar: ClassVar[bool] = True
    """Whether `position` and `goal` mean something, so that figures can show them."""

    def __check_init__(self) -> None:
        check_choice("variant", self.variant, self.variants)
        check_choice("reward_kind", self.reward_kind, RewardKind)
        check_number("horizon", self.horizon, 1)
        if not self.sparse_radius >= 0:
            raise ValueError(f"`sparse_radius` must be at least 0, got {self.sparse_radius}.")

    def __hash__(self) -> int:
        """Hash arrays by their shape: they have no hash, and equality compares their values."""
        leaves = jax.tree.leaves(self)
        plain = (x if isinstance(x, bool | int | float | str) else np.shape(x) for x in leaves)
        return hash((type(self), *plain))

    @abstractmethod
    def start(self, key: Key, task: Task) -> Any:
        """Return how an episode starts: a pytree of arrays that the world understands."""

    @abstractmethod
    def control(self, action: Action) -> Float[Array, " control"]:
        """Map the policy's unbounded action to what reaches the actuators."""

    @abstractmethod
    def observe(self, readings: Readings) -> Float[Array, " observed"]:
        """Return what the agent sees of the world."""

    def observation_names(self) -> tuple[str, ...]:
        """Return names of the components of an observation; none if `observe` tells them."""
        return ()

    def instruction(self, task: Task) -> Float[Array, " instruction"]:
        """Return what the agent sees of its task, appended to the observation; empty by default."""
        return jnp.zeros(0)

    def describe(self, task: Task) -> Float[Array, " description"]:
        """Return a vector that identifies the task, for oracles alone: by default all of it."""
        leaves = [jnp.ravel(jnp.asarray(leaf)).astype(float) for leaf in jax.tree.leaves(task)]
        return jnp.concatenate(leaves)

    @abstractmethod
    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: Task
    ) -> Reward:
        """Return the reward of one step."""

    @property
    def uninformative_reward(self) -> float:
        """Goal part of the sparse reward that a policy with rewards as inputs sees far away."""
        return 0.0

    def far_reward(self, task: Task) -> Float[Array, ""]:
        """Return the goal part of the sparse reward outside of the radius; NaN if not known."""
        return jnp.full((), jnp.nan)

    def situation(self, task: Task) -> Any:
        """Return what of a task an episode depends on, by default all; the rest decides rewards.

        A policy that sees neither task nor reward plays the same episodes in tasks of one
        situation, so that each can be judged in all.
        """
        return task

    def observed_reward(
        self,
        kind: ObservedReward,
        readings: Readings,
        action: Action,
        next_readings: Readings,
        task: Task,
    ) -> Float[Array, ""]:
        """Return the reward of one step as a policy sees it that has rewards as inputs.

        Far from the goal the sparse reward of the reference is the dense one at the start, which
        depends on the distance of the goal. A policy sees `uninformative_reward` there instead,
        the same in all tasks.
        """
        as_is = kind == "own" or self.has_one_reward
        env = self if as_is else dataclasses.replace(self, reward_kind="sparse")
        reward = env.reward(readings, action, next_readings, task)
        if self.has_one_reward or env.reward_kind == "dense":
            return reward.total
        near = env.solved(next_readings, task)
        return jnp.where(near, reward.goal, env.uninformative_reward) + reward.other

    def terminated(self, readings: Readings) -> Bool[Array, ""]:
        """Whether the episode ends by nature in this state: never, unless overridden."""
        return jnp.zeros((), bool)

    @abstractmethod
    def truncated(self, readings: Readings) -> Bool[Array, ""]:
        """Whether the world itself cuts the episode off in this state, before `horizon`."""

    @abstractmethod
    def solved(self, readings: Readings, task: Task) -> Bool[Array, ""]:
        """Whether the goal region is reached in this state."""

    @abstractmethod
    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        """Return the agent's planar position (metres), for figures."""

    def judged_position(self, readings: Readings, task: Task) -> Float[Array, " 2"]:
        """Return the planar position (metres) of what must reach the goal, by default the agent."""
        return self.position(self.observe(readings))

    @abstractmethod
    def goal(self, task: Task) -> Float[Array, " 2"]:
        """Return the task's planar position (metres), for figures."""

    def landmarks(self, task: Task) -> Float[Array, "landmark 2"]:
        """Return the planar positions (metres) of what a task places beside its goal, if any."""
        return jnp.zeros((0, 2))


class AbstractSimulatedEnv(AbstractEnv[Task]):
    """An environment whose world is a state of positions and velocities."""

    @abstractmethod
    def initial(self, key: Key, task: Task) -> tuple[Float[Array, " qpos"], Float[Array, " qvel"]]:
        """Return the positions and velocities that an episode starts from."""

    def model_fields(self, task: Task) -> dict[str, Array]:
        """Return what the task changes in the dynamics, by default nothing: quantity -> values."""
        return {}

    def start(self, key: Key, task: Task) -> Start:
        return Start(*self.initial(key, task), self.model_fields(task))

    def truncated(self, readings: Readings) -> Bool[Array, ""]:
        """Never: `horizon` is the only clock."""
        return jnp.zeros((), bool)


class AbstractMujocoEnv(AbstractSimulatedEnv[Task]):
    """An environment whose world is moved by a MuJoCo model."""

    engine: ClassVar[str] = "mujoco.batch"
    model: eqx.AbstractClassVar[str]
    """Name of a model below `maesn/physics/models`, the path of a user's own file, or XML."""
    readings: eqx.AbstractClassVar[tuple[str, ...]]
    """Names of the engine's quantities that the functions above read."""
    frame_skip: ClassVar[int] = 1
    """Physics steps per control step."""
    nonfinite: ClassVar[Literal["raise", "report"]] = "raise"
    """What happens when a state blows up: an error, or `terminated` has to expect it."""


class AbstractPureEnv(AbstractSimulatedEnv[Task]):
    """An environment that moves its own world, in JAX."""

    engine: ClassVar[str] = "jax"

    @abstractmethod
    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        """Return the readings one control step later."""


AnyEnv: TypeAlias = AbstractEnv[Any]
