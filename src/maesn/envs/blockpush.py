"""A gripper that pushes one of five blocks to a goal (section "Robotic Manipulation").

The agent never sees which block counts and has to try them. In the reference it does not see the
goal either. In the paper it does: the state holds "the positions of all of the objects, the goal
position, and the configuration of the hand".

Observation (26 components; 28 in the variant `paper`):

| index | quantity                                           | unit  |
|-------|----------------------------------------------------|-------|
| 0-1   | position x, y of the gripper                       | m     |
| 2     | angle of the gripper                               | rad   |
| 3-12  | position x, y of blocks 0 to 4                     | m     |
| 13-14 | velocity x, y of the gripper                       | m/s   |
| 15    | rate of turn of the gripper                        | rad/s |
| 16-25 | velocity x, y of blocks 0 to 4                     | m/s   |
| 26-27 | `paper` only, the instruction: goal x, y           | m     |

Action (3 components a, unbounded; the motors receive u = clip(2 a, -2, 2)): force on the gripper in
x and y (N), and torque about z (N m).

Episodes last 100 steps of 0.01 s and never terminate. They start exactly as the task says, at rest
and with the gripper at the origin: nothing is random but the policy. At full force the gripper
moves up to 4 cm per step, which is as thick as its bars: it can jump through a block.

The goal lies in the same band of y as its block. So the variant `paper`, which shows the goal,
gives away which block is meant.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from maesn.axes import Action, Key, Readings
from maesn.envs.base import AbstractMujocoEnv, Reward, RewardKind, Variant
from maesn.envs.goals import goal_reward
from maesn.envs.tasks import TaskFamily

NUM_BLOCKS = 5
SPARSE_RADIUS = 0.2  # metres; appendix "Reward Functions"
REWARD_SCALE = 5.0  # reference, per metre
# The paper calls it "an uninformative large negative constant". In the reference it is |g| (times
# its scale), which is 0.75 to 1.07 m; this is the round number among them.
C_MAX = 1.0
ACTION_SCALE = 2.0  # the motors' range, +-2 N and N m
BLOCK_SPACING = 0.2  # metres; in the model, block b is at home at x = 0.2 (b + 1), y = 0

# Where tasks are drawn from, in metres; reference. Each block has a band of y to itself, and its
# goal lies in the same band.
BLOCK_X = (0.35, 0.65)
GOAL_X = (0.75, 0.95)
LOWEST_Y = -0.5
BAND_HEIGHT = 0.2


class BlockPushTask(NamedTuple):
    """A block, its goal, and the initial positions of all blocks."""

    block: Int[Array | np.ndarray, "*row"]
    """Index of the block that counts, 0 to 4."""
    goal: Float[Array | np.ndarray, "*row 2"]
    """Goal position of the block, in metres."""
    layout: Float[Array | np.ndarray, "*row 5 2"]
    """Initial positions of the five blocks, in metres."""


class BlockPush(AbstractMujocoEnv[BlockPushTask]):
    """A gripper among five blocks, one of which, unknown to it, has to reach the goal."""

    name: ClassVar[str] = "blockpush"
    model: ClassVar[str] = "blockpush.xml"
    readings: ClassVar[tuple[str, ...]] = ("qpos", "qvel")
    control_period: ClassVar[float] = 0.01

    variant: Variant = "reference"
    reward_kind: RewardKind = "dense"
    sparse_radius: float = SPARSE_RADIUS
    horizon: int = 100
    observation_size: int = eqx.field(init=False)
    action_size: int = 3

    def __post_init__(self) -> None:
        self.observation_size = 28 if self.variant == "paper" else 26

    def initial(
        self, key: Key, task: BlockPushTask
    ) -> tuple[Float[Array, " 13"], Float[Array, " 13"]]:
        moved = jnp.asarray(task.layout) - _homes()
        return jnp.concatenate([jnp.zeros(3), moved.reshape(-1)]), jnp.zeros(13)

    def control(self, action: Action) -> Float[Array, " 3"]:
        return jnp.clip(ACTION_SCALE * action, -ACTION_SCALE, ACTION_SCALE)

    def observe(self, readings: Readings) -> Float[Array, " 26"]:
        gripper, blocks = readings["qpos"][:3], _blocks(readings)
        return jnp.concatenate([gripper, blocks.reshape(-1), readings["qvel"]])

    def instruction(self, task: BlockPushTask) -> Float[Array, " instruction"]:
        return jnp.asarray(task.goal) if self.variant == "paper" else jnp.zeros(0)

    def describe(self, task: BlockPushTask) -> Float[Array, " 7"]:
        """Return which block counts (one-hot) and where it is to go; the layout is observed."""
        chosen = jnp.arange(NUM_BLOCKS) == task.block
        return jnp.concatenate([chosen.astype(float), jnp.asarray(task.goal)])

    def reward(
        self, readings: Readings, action: Action, next_readings: Readings, task: BlockPushTask
    ) -> Reward:
        """Return the reward of one step, all of it due to the goal.

        With d the distance of the relevant block from the goal g after the step:

            reference:  r = -5 (d 1[near] + |g|_2 1[far])
            paper:      r = -d 1[near] - c_max 1[far]

        Dense, every distance is near; sparse, d > sparse_radius is far. The paper's form is that
        of its appendix "Reward Functions".
        """
        distance = _distance(next_readings, task)
        goal = goal_reward(distance, self._far(task), self.reward_kind, self.sparse_radius)
        return Reward(self._scale * goal, jnp.zeros(()))

    def _far(self, task: BlockPushTask) -> Float[Array, ""]:
        paper = self.variant == "paper"
        return jnp.asarray(-C_MAX) if paper else -jnp.linalg.norm(task.goal)

    def far_reward(self, task: BlockPushTask) -> Float[Array, ""]:
        return self._scale * self._far(task)

    def situation(self, task: BlockPushTask) -> Any:
        """Return the layout; in the variant `paper`, which shows the goal, the whole task."""
        return task if self.variant == "paper" else task.layout

    @property
    def _scale(self) -> float:
        return 1.0 if self.variant == "paper" else REWARD_SCALE

    @property
    def uninformative_reward(self) -> float:
        return -self._scale * C_MAX

    def solved(self, readings: Readings, task: BlockPushTask) -> Bool[Array, ""]:
        return _distance(readings, task) <= self.sparse_radius

    def position(self, observation: Float[Array, " observation"]) -> Float[Array, " 2"]:
        """Return where the gripper is, which the paper's figures of exploration show."""
        return observation[:2]

    def judged_position(self, readings: Readings, task: BlockPushTask) -> Float[Array, " 2"]:
        return _blocks(readings)[task.block]

    def goal(self, task: BlockPushTask) -> Float[Array, " 2"]:
        return jnp.asarray(task.goal)

    def landmarks(self, task: BlockPushTask) -> Float[Array, "5 2"]:
        """Return the initial positions of the blocks."""
        return jnp.asarray(task.layout)


def _homes() -> Float[Array, "5 2"]:
    """Return where the model's blocks are at home: what their coordinates count from."""
    along = BLOCK_SPACING * jnp.arange(1.0, NUM_BLOCKS + 1.0)
    return jnp.stack([along, jnp.zeros(NUM_BLOCKS)], axis=-1)


def _blocks(readings: Readings) -> Float[Array, "5 2"]:
    """Return where the blocks are."""
    return readings["qpos"][3:].reshape(NUM_BLOCKS, 2) + _homes()


def _distance(readings: Readings, task: BlockPushTask) -> Float[Array, ""]:
    return jnp.linalg.norm(_blocks(readings)[task.block] - task.goal)


def _draw_tasks(stream: np.random.Generator, size: int) -> BlockPushTask:
    """Draw layouts, a task for each of their blocks, and shuffle all these tasks.

    If `size` is no multiple of five, the tasks left over are dropped after the shuffle.
    """
    layouts = -(-size // NUM_BLOCKS)
    bands = stream.permuted(np.tile(np.arange(NUM_BLOCKS), (layouts, 1)), axis=1)
    layout, goal = (_scatter(stream, bands, x) for x in (BLOCK_X, GOAL_X))
    which, block = np.divmod(stream.permutation(layouts * NUM_BLOCKS)[:size], NUM_BLOCKS)
    return BlockPushTask(block.astype(np.int32), goal[which, block], layout[which])


def _scatter(
    stream: np.random.Generator, bands: np.ndarray, x: tuple[float, float]
) -> Float[np.ndarray, "layout 5 2"]:
    """Draw a position in the band of each block."""
    along = stream.uniform(*x, bands.shape)
    across = LOWEST_Y + BAND_HEIGHT * (bands + stream.uniform(0.0, 1.0, bands.shape))
    return np.stack([along, across], axis=-1).astype(np.float32)


def _check_tasks(tasks: BlockPushTask) -> None:
    """Raise ValueError for a block that is not there: JAX would silently take the nearest."""
    wrong = np.flatnonzero((tasks.block < 0) | (tasks.block >= NUM_BLOCKS))
    if wrong.size:
        raise ValueError(
            f"`block` must be an index from 0 to {NUM_BLOCKS - 1}, got "
            f"{tasks.block[wrong[0]]} in row {wrong[0]}"
        )


blockpush = TaskFamily(
    "blockpush",
    BlockPush,
    _draw_tasks,
    task_names=("block", "goal", "layout"),
    seed=5,
    check_tasks=_check_tasks,
)
