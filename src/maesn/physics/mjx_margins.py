"""Replace contact margins by larger geoms where MJX ignores margins.

MuJoCo pushes two geoms apart as soon as they are nearer than the sum of their margins. MJX does so
for planes and between spheres and capsules. But with a box, MJX finds no contact until the geoms
overlap; then the contact is suddenly as deep as the margin.
"""

import copy
from collections.abc import Iterator
from itertools import combinations

import mujoco
import numpy as np

_PLANE, _SPHERE, _CAPSULE, _BOX = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")) for name in ("PLANE", "SPHERE", "CAPSULE", "BOX")
)
_GROWABLE = {_SPHERE, _CAPSULE, _BOX}


class MarginError(ValueError):
    """MJX ignores a contact margin, and larger geoms cannot replace it."""


def margins_as_sizes(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy in which geoms that can touch a box are larger by their margin and have none.

    Growing a sphere, a capsule or a box by its margin moves its whole surface outwards by the
    margin. So the distance in MJX is MuJoCo's distance minus the margin, and a contact's force
    depends on nothing else. The two differ only at the edges of a box: the region within the margin
    is rounded in MuJoCo, and has sharp edges here.

    Raises:
        MarginError: MJX ignores the margin of two geoms, and they cannot both be grown.
    """
    model = copy.copy(model)
    to_grow: set[int] = set()
    for first, second in _possible_contacts(model):
        types = {int(model.geom_type[first]), int(model.geom_type[second])}
        margins = model.geom_margin[[first, second]]
        if not margins.any() or _PLANE in types or types <= {_SPHERE, _CAPSULE}:
            continue
        if not types <= _GROWABLE or model.geom_gap[[first, second]].any():
            names = " and ".join(repr(model.geom(geom).name) for geom in (first, second))
            raise MarginError(f"a margin between the geoms {names}")
        to_grow |= {first, second}
    if to_grow and model.npair:
        raise MarginError("explicit pairs beside margins at boxes")
    for geom in to_grow:
        _grow(model, geom)
    return model


def _possible_contacts(model: mujoco.MjModel) -> Iterator[tuple[int, int]]:
    """Yield the pairs of geoms that may touch.

    Some of them MuJoCo may exclude as parent and child.
    """
    for first, second in combinations(range(model.ngeom), 2):
        collide = (
            model.geom_contype[first] & model.geom_conaffinity[second]
            or model.geom_contype[second] & model.geom_conaffinity[first]
        )
        if collide and model.geom_bodyid[first] != model.geom_bodyid[second]:
            yield first, second


def _grow(model: mujoco.MjModel, geom: int) -> None:
    margin = float(model.geom_margin[geom])
    # A sphere or a capsule grows by its radius. A capsule's second size is its half-length.
    extents = 3 if model.geom_type[geom] == _BOX else 1
    model.geom_size[geom, :extents] += margin
    model.geom_rbound[geom] += np.sqrt(extents) * margin
    model.geom_margin[geom] = 0.0
