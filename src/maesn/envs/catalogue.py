"""The families that come with the library, by name."""

from maesn.envs.ant import ant
from maesn.envs.ant_v5 import ant_dir, ant_goal, sparse_ant_goal
from maesn.envs.blockpush import blockpush
from maesn.envs.cheetah import cheetah_body, cheetah_dir, cheetah_vel
from maesn.envs.grid_navi import grid_navi
from maesn.envs.metaworld import HOSTED
from maesn.envs.point import point
from maesn.envs.sparse_point import sparse_point
from maesn.envs.tasks import TaskFamily
from maesn.envs.wheeled import wheeled
from maesn.settings import suggestion

FAMILIES: dict[str, TaskFamily] = {
    family.name: family
    for family in (
        *(point, wheeled, ant, blockpush),
        *(sparse_point, grid_navi),
        *(cheetah_vel, cheetah_dir, cheetah_body, ant_dir, ant_goal, sparse_ant_goal),
    )
}
"""The families to learn: a point mass, three robots, and tasks of other papers."""


def find_family(name: str) -> TaskFamily:
    """Return a family by its name.

    Args:
        name: as in `FAMILIES` or `HOSTED`.

    Raises:
        ValueError: there is no such family; the message names the likeliest one and all others.
    """
    known = FAMILIES | HOSTED
    if name in known:
        return known[name]
    raise ValueError(
        f"`family` must be one of {', '.join(known)}, got `{name}`.{suggestion(name, known)}"
    )


def split_variant(name: str) -> tuple[str, str]:
    """Return family and variant of a name such as `sparse_point:varibad`; "" for no variant."""
    family, _, variant = name.partition(":")
    return (family, variant) if family in FAMILIES else (name, "")


def is_own(family: str) -> bool:
    """Return whether a name is `module:name` of a user's own family."""
    return ":" in family and family.partition(":")[0] not in {x.partition(":")[0] for x in HOSTED}
