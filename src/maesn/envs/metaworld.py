"""Meta-World's ML1: an arm that must reach a hidden point, or push or carry an object to one.

Source: metaworld 3.1.1 (Farama-Foundation/Metaworld), the v3 environments `reach`, `push` and
`pick-place`, as its class `ML1` sets them up. That version needs MuJoCo 3.3.0, which is too old for
this library. So the environments run in an interpreter of their own: `make metaworld` installs it
in `.venv-metaworld`, where the current directory is searched for it, and `--python` names another.

A task is the object's start and the goal, `[6]`, in metres:

| index | quantity                 | `reach`, `pick_place` | `push`       |
|-------|--------------------------|-----------------------|--------------|
| 0-1   | start x, y of the object | -.1 to .1, .6 to .7   | the same     |
| 2     | its height               | .02                   | .02          |
| 3-4   | goal x, y                | -.1 to .1, .8 to .9   | the same     |
| 5     | its height               | .05 to .3             | .01 to .02 * |

in the plane at least .15 m apart. (* Not used: the goal has the height of the object.)

Observation (39 components; the last three hide the goal):

| index | quantity                                                     | unit |
|-------|--------------------------------------------------------------|------|
| 0-2   | position of the hand                                         | m    |
| 3     | how far the gripper is open, 0 to 1                          | 1    |
| 4-10  | position and orientation (a quaternion) of the object        | m, 1 |
| 11-17 | 0, for a second object                                       |      |
| 18-35 | components 0-17 one step earlier                             |      |
| 36-38 | 0                                                            |      |

Action (4 components a; control u = clip(a, -1, 1)): 0-2 move the hand by up to 1 cm in x, y and z
in each step, 3 closes the gripper. An episode has 500 steps of 1/80 s, and all episodes of a task
start alike.

Dense reward is Meta-World's (its version 2, 0 to 10 a step), sparse reward is 1 where Meta-World
reports success and 0 elsewhere: hand or object within 5 cm of the goal, 7 cm in `pick_place`.

Differences from the source: it draws 50 tasks for training and 50 for tests from a seed of the
user's; here each set has 100, and the official protocol takes the first 40 of the test tasks. The
sparse reward is not Meta-World's, but the usual choice.
"""

from functools import partial
from typing import Any

import numpy as np

from maesn.envs.foreign import gymnasium_family
from maesn.envs.tasks import TaskFamily
from maesn.foreign import Interface

PYTHON = ".venv-metaworld/bin/python"
"""The interpreter of `make metaworld`, from the current directory."""

# Metres, of `_random_reset_space`: the object's start and the goal.
_LOWER = (-0.1, 0.6, 0.02, -0.1, 0.8)
_UPPER = (0.1, 0.7, 0.02, 0.1, 0.9)
_GOAL_HEIGHT = {"reach": (0.05, 0.3), "push": (0.01, 0.02), "pick_place": (0.05, 0.3)}
# Metres in the plane. Meta-World draws again where the object lies nearer to the goal. It would do
# so for ever where the task is given.
CLEARANCE = 0.15
HORIZON = 500  # `max_path_length`
# Each takes about 20 MB, most of it for meshes.
_MAX_ENVIRONMENTS = 100

# So nothing that does not play needs Meta-World. Workers refuse an environment with other spaces.
INTERFACE = Interface(
    spaces={
        "observation": ["Box[39]", [f"observation[{index}]" for index in range(39)]],
        "action": ["Box", [-1.0] * 4, [1.0] * 4],
    },
    discrete=False,
    lower=(-1.0,) * 4,
    upper=(1.0,) * 4,
    max_episode_steps=None,
    control_period=1 / 80,
    doubt="",
)


def draw_tasks(
    stream: np.random.Generator, size: int, goal_height: tuple[float, float]
) -> np.ndarray:
    """Draw that many tasks, the object's start and the goal, `[size, 6]` in metres."""
    low, high = ([*bounds, end] for bounds, end in zip((_LOWER, _UPPER), goal_height, strict=True))
    points = stream.uniform(low, high, (size, 6)).astype(np.float32)
    while (near := _distance(points) < CLEARANCE).any():
        points[near] = stream.uniform(low, high, (near.sum(), 6))
    return points


def check_tasks(points: Any) -> None:
    """Refuse by ValueError tasks that Meta-World could not begin."""
    distances = _distance(np.asarray(points))
    if (distances < CLEARANCE).any():
        row = int(np.argmin(distances))
        raise ValueError(
            f"goals must be at least {CLEARANCE} m from the object in the plane, got "
            f"{distances[row]:.3g} m in row {row}."
        )


def _distance(points: np.ndarray) -> np.ndarray:
    between = points[:, 3:5].astype(np.float64) - points[:, :2]  # as Meta-World computes it
    return np.linalg.norm(between, axis=1)


def _family(task: str, what: str, seed: int, of_object: bool) -> TaskFamily:
    first = 4 if of_object else 0  # what is shown from above: the object, or the hand
    family = gymnasium_family(
        f"metaworld:{task}",
        f"maesn_metaworld:{task}",
        partial(draw_tasks, goal_height=_GOAL_HEIGHT[task]),
        task_names=("points",),
        seed=seed,
        horizon=HORIZON,
        position=lambda observation: observation[first : first + 2],
        goal=lambda points: points[3:5],
        max_environments=_MAX_ENVIRONMENTS,
        python=PYTHON,
        interface=INTERFACE,
    )
    family.make_env.__doc__ = f"Meta-World's ML1 {task}: {what}, in an interpreter of its own."
    return family._replace(check_tasks=check_tasks)


HOSTED: dict[str, TaskFamily] = {
    family.name: family
    for family in (
        _family("reach", "an arm must reach a hidden point", 301, of_object=False),
        _family("push", "it must push an object there", 302, of_object=True),
        _family("pick_place", "it must carry an object there", 303, of_object=True),
    )
}
"""The families that run in an interpreter of their own, by name."""
