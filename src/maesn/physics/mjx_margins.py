"""Contact margins where MJX ignores them.

MuJoCo pushes two geoms apart as soon as they are nearer than the sum of their margins. So does MJX
at planes and between spheres and capsules, but at boxes it finds no contact before they overlap,
and then, at once, one as deep as the margin.
"""

import copy
from collections.abc import Iterator

import mujoco
import numpy as np

_PLANE, _SPHERE, _CAPSULE, _BOX = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")) for name in ("PLANE", "SPHERE", "CAPSULE", "BOX")
)
_GROWING = {_SPHERE, _CAPSULE, _BOX}


class MarginError(ValueError):
    """A contact margin that MJX ignores, and that no size can stand in for."""


def margins_as_sizes(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy in which geoms that can meet a box are larger by their margin and have none.

    Growing a sphere, a capsule or a box by its margin moves each of its faces by just as much, so
    that the distance that MJX sees is MuJoCo's distance less the margin, which is all that a
    contact's force depends on. Only at an edge of a box the two differ: there, what is within the
    margin is round in MuJoCo and has a corner here.

    Raises:
        MarginError: a geom with a margin can meet one at which MJX ignores it, and neither can be
            grown.
    """
    model = copy.copy(model)
    grown: set[int] = set()
    for one, other in _meeting(model):
        types = {int(model.geom_type[one]), int(model.geom_type[other])}
        margins = model.geom_margin[[one, other]]
        if not margins.any() or _PLANE in types or types <= {_SPHERE, _CAPSULE}:
            continue
        if not types <= _GROWING or model.geom_gap[[one, other]].any():
            names = " and ".join(repr(model.geom(geom).name) for geom in (one, other))
            raise MarginError(f"a margin between the geoms {names}")
        grown |= {one, other}
    if grown and model.npair:
        raise MarginError("explicit pairs beside margins at boxes")
    for geom in sorted(grown):
        _grow(model, geom)
    return model


def _meeting(model: mujoco.MjModel) -> Iterator[tuple[int, int]]:
    """Yield the pairs of geoms that may touch, and perhaps some that the bodies' tree forbids."""
    for one in range(model.ngeom):
        for other in range(one + 1, model.ngeom):
            meets = (
                model.geom_contype[one] & model.geom_conaffinity[other]
                or model.geom_contype[other] & model.geom_conaffinity[one]
            )
            bodies = model.geom_bodyid[[one, other]]
            if meets and bodies[0] != bodies[1]:
                yield one, other


def _grow(model: mujoco.MjModel, geom: int) -> None:
    margin = float(model.geom_margin[geom])
    extents = 3 if model.geom_type[geom] == _BOX else 1  # a capsule's second size is its length
    model.geom_size[geom, :extents] += margin
    model.geom_rbound[geom] += np.sqrt(extents) * margin
    model.geom_margin[geom] = 0.0
