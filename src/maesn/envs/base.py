"""Environments: pure functions of one episode, and the tasks that they are asked to solve.

An environment says how an episode starts, what the agent sees, what it is paid, and when it ends.
It holds no state and knows no batch. What moves the world is someone else's business: a physics
engine for `AbstractMujocoEnv`, the environment's own `advance` for `AbstractPureEnv`.
"""

from abc import abstractmethod
from typing import Any, Generic, Literal, NamedTuple, TypeAlias, TypeVar, get_args

import equinox as eqx
from jaxtyping import Array, Bool, Float

from maesn.axes import Key, Readings

RewardKind: TypeAlias = Literal["dense", "sparse"]
"""Dense in meta-training, sparse in meta-testing (section "Comparisons")."""

Variant: TypeAlias = Literal["reference", "paper"]
"""`reference` follows the code behind the published curves, `paper` the formulas as printed."""

Task = TypeVar("Task")


class Reward(NamedTuple):
    """The reward of one step, in two parts."""

    goal: Float[Array, "*batch"]
    """What is paid for the goal."""
    other: Float[Array, "*batch"]
    """Control costs, contact costs, survival bonus: what no goal has to do with."""

    @property
    def total(self) -> Float[Array, "*batch"]:
        """What the agent is paid."""
        return self.goal + self.other


class AbstractEnv(eqx.Module, Generic[Task]):
    """The world of one episode, as pure functions.

    `observe` receives no task. An environment that tells the agent its goal does so through
    `instruction`, in plain sight, or not at all.
    """

    name: eqx.AbstractClassVar[str]
    horizon: eqx.AbstractVar[int]
    """T, the number of control steps of an episode."""
    control_period: eqx.AbstractClassVar[float]
    """Seconds between two control steps."""
    observation_size: eqx.AbstractVar[int]
    """Components of an observation, instruction included."""
    action_size: eqx.AbstractVar[int]
    reward_kind: eqx.AbstractVar[RewardKind]
    sparse_radius: eqx.AbstractVar[float]
    """Radius of the goal region."""
    variant: eqx.AbstractVar[Variant]

    def __check_init__(self) -> None:
        # A misspelt kind or variant would not fail: it would silently count as the other one.
        for setting, known in (("variant", Variant), ("reward_kind", RewardKind)):
            value = getattr(self, setting)
            if value not in get_args(known):
                names = " or ".join(map(repr, get_args(known)))
                raise ValueError(f"`{setting}` must be {names}, got {value!r}.")
        if self.horizon < 1:
            raise ValueError(f"`horizon` must be at least 1, got {self.horizon}.")
        if not self.sparse_radius >= 0:
            raise ValueError(f"`sparse_radius` must be at least 0, got {self.sparse_radius}.")

    @abstractmethod
    def initial(self, key: Key, task: Task) -> tuple[Float[Array, " qpos"], Float[Array, " qvel"]]:
        """Return the positions and velocities that an episode starts from."""

    @abstractmethod
    def control(self, action: Float[Array, " action"]) -> Float[Array, " control"]:
        """Map the policy's unbounded action to what reaches the actuators."""

    @abstractmethod
    def observe(self, readings: Readings) -> Float[Array, " observed"]:
        """Return what the agent sees of the world."""

    @abstractmethod
    def instruction(self, task: Task) -> Float[Array, " instruction"]:
        """Return what the agent is told of its task: a vector appended to the observation."""

    @abstractmethod
    def reward(
        self,
        readings: Readings,
        action: Float[Array, " action"],
        next_readings: Readings,
        task: Task,
    ) -> Reward:
        """Return the reward of one step."""

    @abstractmethod
    def terminated(self, readings: Readings) -> Bool[Array, ""]:
        """Whether the episode ends by nature in this state."""

    @abstractmethod
    def solved(self, readings: Readings, task: Task) -> Bool[Array, ""]:
        """Whether the goal region is reached in this state."""

    @abstractmethod
    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        """Return the planar position (metres) by which figures show where the agent is."""

    @abstractmethod
    def goal(self, task: Task) -> Float[Array, " 2"]:
        """Return the planar position (metres) by which figures show the task."""

    @abstractmethod
    def model_fields(self, task: Task) -> dict[str, Array]:
        """Return what the task changes in the dynamics: name of the quantity -> values."""


class AbstractMujocoEnv(AbstractEnv[Task]):
    """An environment whose world is moved by a MuJoCo model."""

    model: eqx.AbstractClassVar[str]
    """File name of the model below `maesn/physics/models`, or the path of a user's own file."""
    readings: eqx.AbstractClassVar[tuple[str, ...]]
    """Names of the engine's quantities that the functions above read."""


class AbstractPureEnv(AbstractEnv[Task]):
    """An environment that moves its own world, in JAX."""

    @abstractmethod
    def advance(self, readings: Readings, control: Float[Array, " control"]) -> Readings:
        """Return the readings one control step later."""


AnyEnv: TypeAlias = AbstractMujocoEnv[Any] | AbstractPureEnv[Any]
