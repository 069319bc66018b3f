"""The families that come with the library, by name."""

from maesn.envs.ant import ant
from maesn.envs.bandit import bandit
from maesn.envs.blockpush import blockpush
from maesn.envs.chain import chain
from maesn.envs.point import point
from maesn.envs.probes import hidden_end, hidden_side
from maesn.envs.target_probes import delayed_target, hidden_target
from maesn.envs.tasks import TaskFamily
from maesn.envs.wheeled import wheeled
from maesn.settings import suggestion

FAMILIES: dict[str, TaskFamily] = {
    family.name: family for family in (point, wheeled, ant, blockpush)
}
"""The families to learn: a point mass and three robots."""

PROBES: dict[str, TaskFamily] = {
    family.name: family
    for family in (hidden_target, delayed_target, hidden_side, hidden_end, bandit, chain)
}
"""Tiny families whose best return is known; see `maesn.envs.probes`."""


def find_family(name: str) -> TaskFamily:
    """Return a family or a probe by its name.

    Args:
        name: as in `FAMILIES` and `PROBES`.

    Raises:
        ValueError: there is no such family; the message names the likeliest one and all others.
    """
    known = FAMILIES | PROBES
    if name in known:
        return known[name]
    raise ValueError(
        f"`family` must be one of {', '.join(FAMILIES)} or one of the probes {', '.join(PROBES)}, "
        f"got `{name}`.{suggestion(name, known)}"
    )
