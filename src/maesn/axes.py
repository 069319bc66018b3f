"""Names of the axes that every array of the library is annotated with, and type aliases.

Arrays are ordered `[task, episode, time, feature]`. The task axis comes first because it is the
axis that is mapped over and cut into chunks. Functions are written for one task or one episode;
`maesn.numerics.tasks.map_tasks` adds the axis of the tasks.

| axis          | runs over                                                                     |
|---------------|-------------------------------------------------------------------------------|
| `task`        | slots of the batch of tasks that is being played                              |
| `row`         | tasks of a finite task set, such as the rows of the table of latents          |
| `episode`     | episodes of one task, played in parallel                                      |
| `time`        | control steps of one episode, t = 0 ... T-1                                   |
| `time_plus_1` | states of one episode, t = 0 ... T                                            |
| `observation` | components of what the policy sees of the world                               |
| `action`      | components of one action                                                      |
| `z`           | components of what a context feeds to the policy throughout one episode       |
| `noise`       | components of the standard normal draw behind one z                           |
| `description` | components of the description of a task                                       |
| `simulation`  | simulations of one batch of the engine: task-major, `task * episodes + episode` |
"""

from typing import Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray
from jaxtyping import Key as KeyArray

# One random key.
Key: TypeAlias = PRNGKeyArray

# One random key per task slot.
TaskKeys: TypeAlias = KeyArray[Array, " task"]

# What a policy does in one step, before anything is clipped or scaled.
Action: TypeAlias = Float[Array, " action"]

# Named quantities of the simulated world. The names are the physics engine's own ("qpos", "qvel",
# "subtree_com", ...), so an environment and its engine agree on them without a translation table.
Readings: TypeAlias = dict[str, Array]
HostReadings: TypeAlias = dict[str, np.ndarray]

# What a recurrent policy keeps from step to step; `None` for one that is not recurrent.
RecurrentState: TypeAlias = Any

# What actions are: a vector of real numbers, or one of `action_size` choices. A choice is written
# as a one-hot vector, so that actions are float arrays of `action_size` components either way.
ActionKind: TypeAlias = Literal["continuous", "discrete"]

# The reward that a policy receives as an input: the world's own, dense or sparse, or the sparse
# one in every world.
ObservedReward: TypeAlias = Literal["own", "sparse"]
