"""The library's models: their text, and what can be read from the compiled ones."""

import xml.etree.ElementTree as ElementTree
from importlib import resources

import mujoco
import numpy as np

ROBOTS = ("ant", "blockpush", "wheeled")
LOOKS = {"site", "camera", "light", "visual", "statistic", "asset", "sensor"}


def text_of(robot: str) -> str:
    return (resources.files("maesn.physics") / f"models/{robot}.xml").read_text("utf-8")


def without_looks(robot: str) -> mujoco.MjModel:
    """The model without all that is only to be seen, or only sees."""
    root = ElementTree.fromstring(text_of(robot))
    for parent in list(root.iter()):
        parent.attrib.pop("material", None)
        for child in list(parent):
            if child.tag in LOOKS or child.get("mocap"):
                parent.remove(child)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


def names(model: mujoco.MjModel, kind: mujoco.mjtObj, count: int) -> list[str]:
    return [mujoco.mj_id2name(model, kind, index) for index in range(count)]


def inertia_tensor(model: mujoco.MjModel, body: str) -> np.ndarray:
    """Inertia about the centre of mass, along the axes of the body."""
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, model.body(body).iquat)
    axes = axes.reshape(3, 3)
    return axes @ np.diag(model.body(body).inertia) @ axes.T
