"""An exported policy as an ONNX file, for robots that are not programmed in Python.

    pip install onnx
    maesn export wheeled policy.npz
    python examples/policy_to_onnx.py policy.npz policy.onnx

The network takes `observation` and `z`, `[batch, ...]` each. It returns `control`, what the
actuators are sent at the mean action, and this `action` itself, for those who add noise to explore.
"""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray

from maesn.runtime import Explorer, ExportedPolicy, facts

# Old enough for the runtimes of the last years; the operators are older still.
_OPSET, _IR_VERSION = 17, 8


def write_onnx(path: str | os.PathLike[str], exported: ExportedPolicy) -> None:
    """Write a policy as an ONNX file, with all that a robot must know as metadata, in JSON.

    Raises:
        ValueError: the policy searches, which a network cannot.
    """
    if exported.search is not None:
        raise ValueError("a network cannot search: export without `--rule`, and with `--latents`.")
    model = onnx.helper.make_model(
        _graph(exported),
        opset_imports=[onnx.helper.make_opsetid("", _OPSET)],
        ir_version=_IR_VERSION,
        producer_name="maesn",
    )
    texts = {name: json.dumps(value) for name, value in _metadata(exported).items()}
    onnx.helper.set_model_props(model, texts)
    onnx.checker.check_model(model, full_check=True)
    Path(path).write_bytes(model.SerializeToString())


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
        "facts": facts(exported),
    }


def _graph(exported: ExportedPolicy) -> Any:
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

    def clip(value: str, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> str:
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


def _inside(limit: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return a limit in single precision that does not lie beyond it."""
    single = limit.astype(np.float32)
    outside = np.where(other > limit, single < limit, single > limit)
    return np.where(outside, np.nextafter(single, other.astype(np.float32)), single)


def main() -> None:
    """Convert a file, and show what a robot gets and must give."""
    parser = argparse.ArgumentParser(description="Write an exported policy as an ONNX file.")
    parser.add_argument("source", help=".npz file of `maesn export`")
    parser.add_argument("target", help=".onnx file to write")
    asked = parser.parse_args()
    try:
        policy = Explorer.load(asked.source).exported
        write_onnx(asked.target, policy)
    except (OSError, ValueError) as error:
        sys.exit(str(error))
    print(*(f"{what:20s} {value}" for what, value in facts(policy)), asked.target, sep="\n")


if __name__ == "__main__":
    main()
