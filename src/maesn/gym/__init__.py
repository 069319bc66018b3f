"""The families of the library as Gymnasium environments: `maesn/Wheeled-v0` and so on.

Importing this package registers them, which `gymnasium.make("maesn.gym:maesn/Wheeled-v0")` does by
itself.
"""

from importlib.util import find_spec

if find_spec("gymnasium") is None:
    raise ImportError("`maesn.gym` needs Gymnasium: pip install -e '.[gym]' in its clone")

import gymnasium

from maesn.envs import FAMILIES
from maesn.gym.env import TaskEnv as TaskEnv

IDS = {name: f"maesn/{type(family.make_env()).__name__}-v0" for name, family in FAMILIES.items()}
"""Family -> the name under which Gymnasium makes it.

Users write these names: a class of the library that is renamed must keep its own here.
"""

for _family, _id in IDS.items():
    if _id not in gymnasium.registry:
        gymnasium.register(_id, entry_point="maesn.gym:TaskEnv", kwargs={"family": _family})
