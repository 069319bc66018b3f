"""The families of the library as Gymnasium environments: `maesn/Wheeled-v0` and so on.

Importing this package registers them, which `gymnasium.make("maesn.gym:maesn/Wheeled-v0")` does by
itself.
"""

from importlib.util import find_spec

if find_spec("gymnasium") is None:
    raise ImportError("`maesn.gym` needs Gymnasium: pip install -e '.[gym]' in its clone")

import gymnasium

from maesn.gym.env import TaskEnv as TaskEnv

IDS: dict[str, str] = {
    "wheeled": "maesn/Wheeled-v0",
    "ant": "maesn/Ant-v0",
    "blockpush": "maesn/BlockPush-v0",
    "point": "maesn/Point-v0",
    "sparse_point": "maesn/SparsePoint-v0",
    "grid_navi": "maesn/GridNavi-v0",
    "cheetah_vel": "maesn/CheetahVel-v0",
    "cheetah_dir": "maesn/CheetahDir-v0",
    "cheetah_body": "maesn/CheetahBody-v0",
    "ant_dir": "maesn/AntDir-v0",
    "ant_goal": "maesn/AntGoal-v0",
    "sparse_ant_goal": "maesn/SparseAntGoal-v0",
}
"""Family -> the name under which Gymnasium makes it."""

for _family, _id in IDS.items():
    if _id not in gymnasium.registry:
        gymnasium.register(_id, entry_point="maesn.gym:TaskEnv", kwargs={"family": _family})
