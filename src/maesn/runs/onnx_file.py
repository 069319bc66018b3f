"""An exported policy as an ONNX file, for robots that are not programmed in Python.

The network takes `observation` and `z`, `[batch, ...]` each. It returns `control`, what the
actuators are sent at the mean action, and this `action` itself, for those who add noise to explore.
"""

import json
import os
from importlib import import_module
from typing import Any

import numpy as np

from maesn.runtime import ExportedPolicy
from maesn.runtime.archive import write_whole
from maesn.runtime.arrays import FloatArray
from maesn.runtime.policy import Weights
from maesn.runtime.table import facts

SUFFIX = ".onnx"
# Old enough for the runtimes of the last years; the operators are older still.
_OPSET, _IR_VERSION = 17, 8
_FACTS = "facts"

NO_SEARCH = (
    "an ONNX file is a network, which cannot search: leave out `rule`, and give the latents of an "
    "adaptation, or search with the `.npz` file."
)


def is_onnx(path: str | os.PathLike[str]) -> bool:
    """Whether a path names an ONNX file."""
    return os.fspath(path).lower().endswith(SUFFIX)


def write_onnx(path: str | os.PathLike[str], exported: ExportedPolicy) -> None:
    """Write a policy as an ONNX file, with all that a robot must know as metadata, in JSON.

    `ValueError` says that the policy searches, which a network cannot, or that `onnx` is missing.
    """
    if exported.search is not None:
        raise ValueError(NO_SEARCH)
    onnx = _onnx()
    model = onnx.helper.make_model(
        _graph(onnx, exported),
        opset_imports=[onnx.helper.make_opsetid("", _OPSET)],
        ir_version=_IR_VERSION,
        producer_name="maesn",
    )
    texts = {name: json.dumps(value) for name, value in _metadata(exported).items()}
    onnx.helper.set_model_props(model, texts)
    onnx.checker.check_model(model, full_check=True)
    write_whole(path, model.SerializeToString())


def read_facts(path: str | os.PathLike[str]) -> list[tuple[str, str]]:
    """Return the table for people that an ONNX file holds; OSError if it cannot be opened."""
    properties = {one.key: one.value for one in _onnx().load(os.fspath(path)).metadata_props}
    return [(what, value) for what, value in json.loads(properties[_FACTS])]


def _onnx() -> Any:
    try:
        return import_module("onnx")
    except ImportError as error:
        raise ValueError("an ONNX file needs onnx: pip install -e '.[onnx]'.") from error


def _metadata(exported: ExportedPolicy) -> dict[str, Any]:
    actuators, sensors = exported.actuators, exported.sensors
    arrays = {
        "offset": actuators.offset,
        "scale": actuators.scale,
        "lower": actuators.lower,
        "upper": actuators.upper,
        "observation_lower": sensors.lower,
        "observation_upper": sensors.upper,
        "action_std": exported.policy.std,
        "latent_mean": exported.start.mean,
        "latent_std": exported.start.std,
    }
    return {
        **exported.description,
        "updates": exported.start_update,
        "observations": sensors.names,
        "actuators": actuators.names,
        "is_noisy": dict(exported.is_noisy),
        # JSON has no infinity.
        **{name: [x if np.isfinite(x) else None for x in held] for name, held in arrays.items()},
        _FACTS: facts(exported),
    }


def _graph(onnx: Any, exported: ExportedPolicy) -> Any:
    """Return the network: a = mlp([o, z]), and clip(offset + scale * a, lower, upper)."""
    helper = onnx.helper
    nodes: list[Any] = []
    constants: dict[str, np.ndarray] = {}

    def constant(value: np.ndarray) -> str:
        name = f"constant_{len(constants)}"
        constants[name] = np.asarray(value, np.float32)
        return name

    def add(operator: str, *inputs: str | np.ndarray, **attributes: Any) -> str:
        names = [one if isinstance(one, str) else constant(one) for one in inputs]
        result = f"value_{len(nodes)}"
        nodes.append(helper.make_node(operator, names, [result], **attributes))
        return result

    def clip(value: str, lower: FloatArray, upper: FloatArray) -> str:
        return add("Min", add("Max", value, _inside(lower, upper)), _inside(upper, lower))

    seen = clip("observation", exported.sensors.lower, exported.sensors.upper)
    value = add("Concat", seen, "z", axis=1)
    policy, actuators = exported.policy, exported.actuators
    last = len(policy.weights) - 1
    for layer, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        value = add("Add", add("MatMul", value, weight), bias)
        value = value if layer == last else add("Relu", value)
    nodes[-1].output[0] = "action"
    control = add("Add", add("Mul", "action", actuators.scale), actuators.offset)
    clip(control, actuators.lower, actuators.upper)
    nodes[-1].output[0] = "control"

    def tensor(name: str, size: int) -> Any:
        return helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["batch", size])

    size = exported.action_size
    return helper.make_graph(
        nodes,
        "policy",
        [tensor("observation", exported.observation_size), tensor("z", exported.latent_size)],
        [tensor("control", size), tensor("action", size)],
        [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()],
    )


def _inside(limit: FloatArray, other: FloatArray) -> Weights:
    """Return a limit in single precision that does not lie beyond it."""
    single = limit.astype(np.float32)
    outside = np.where(other > limit, single < limit, single > limit)
    return np.where(outside, np.nextafter(single, other.astype(np.float32)), single)
