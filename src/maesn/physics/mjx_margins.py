"""Replace contact margins by larger geoms where MJX ignores margins.

MuJoCo pushes two geoms apart as soon as they are nearer than the sum of their margins. MJX does so
for planes and between spheres and capsules. But with a box, MJX finds no contact until the geoms
overlap; then the contact is suddenly as deep as the margin.
"""

import copy

import mujoco
import numpy as np

_PLANE, _SPHERE, _CAPSULE, _BOX = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")) for name in ("PLANE", "SPHERE", "CAPSULE", "BOX")
)


class MarginError(ValueError):
    """MJX ignores a contact margin, and larger geoms cannot replace it."""


def margins_as_sizes(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy in which geoms are larger by their margin, if the model needs that.

    Growing a sphere, a capsule or a box by its margin moves its whole surface outwards by the
    margin. So the distance in MJX is MuJoCo's distance minus the margin, and a contact's force
    depends on nothing else. The two differ only at the edges of a box: the region within the margin
    is rounded in MuJoCo, and has sharp edges here.

    Raises:
        MarginError: MJX ignores the margin of a geom that cannot be grown.
    """
    model = copy.copy(model)
    touches = (model.geom_contype | model.geom_conaffinity) != 0
    if np.isin(model.geom_type[touches], (_PLANE, _SPHERE, _CAPSULE)).all():
        return model
    for geom in np.flatnonzero(touches & (model.geom_margin > 0) & (model.geom_type != _PLANE)):
        growable = model.geom_type[geom] in (_SPHERE, _CAPSULE, _BOX)
        if not growable or model.geom_gap[geom] or model.npair:
            raise MarginError(f"a margin of the geom {model.geom(geom).name!r}")
        _grow(model, int(geom))
    return model


def _grow(model: mujoco.MjModel, geom: int) -> None:
    margin = float(model.geom_margin[geom])
    # A sphere or a capsule grows by its radius. A capsule's second size is its half-length.
    extents = 3 if model.geom_type[geom] == _BOX else 1
    model.geom_size[geom, :extents] += margin
    model.geom_rbound[geom] += np.sqrt(extents) * margin
    model.geom_margin[geom] = 0.0
