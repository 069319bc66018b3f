"""The ONNX file computes what the NumPy runtime does, and says what a robot must know."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from runtime.robot import fast_learner
from runtime.test_limits import Driven, Odd
from runtime.test_search import PRIOR

from maesn import cli
from maesn.context import Latent
from maesn.envs import AnyEnv, Point, Wheeled
from maesn.evaluation.exporting import exported_policy, write_policy
from maesn.runtime import Explorer
from maesn.runtime.search import SearchSettings

onnx = pytest.importorskip("onnx", reason="needs onnx: pip install onnx")
ort = pytest.importorskip("onnxruntime", reason="needs onnxruntime: pip install onnxruntime")
example = pytest.importorskip("policy_to_onnx")

START = Latent(jnp.asarray([0.5, -1.0]), jnp.asarray([-0.25, 0.125]))


def session(path: Path) -> Any:
    return ort.InferenceSession(str(path), providers=["CPUExecutionProvider"])


@pytest.mark.parametrize("env", [Point(), Wheeled(), Odd(), Driven(reach=0.25)])
def test_the_network_is_the_runtime(env: AnyEnv, tmp_path: Path) -> None:
    exported = exported_policy(fast_learner(env), env, {})
    example.write_onnx(tmp_path / "policy.onnx", exported)
    network, generator = session(tmp_path / "policy.onnx"), np.random.default_rng(0)
    explorer = Explorer(exported, seed=1)
    wanted, seen, latents = [], [], []
    for size in np.geomspace(0.01, 1000.0, 60):
        seen.append(size * generator.standard_normal(exported.observation_size))
        latents.append(explorer.begin_episode(z=3.0 * generator.standard_normal(2)))
        control = explorer.act(seen[-1], explore=False)
        wanted.append((control, explorer.end_episode([0.0]).actions[0]))
    feed = {"observation": np.float32(seen), "z": np.float32(latents)}
    control, action = network.run(["control", "action"], feed)
    np.testing.assert_allclose(control, [one for one, _ in wanted], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(action, [one for _, one in wanted], rtol=1e-4, atol=1e-5)
    alone = network.run(None, {name: x[:1] for name, x in feed.items()})[0]
    np.testing.assert_allclose(alone, control[:1], rtol=1e-6)
    # Not even rounding leads beyond a limit: .2 in single precision is above .2.
    assert (np.float64(control) <= exported.actuators.upper).all()
    assert (np.float64(control) >= exported.actuators.lower).all()


def test_the_file_says_what_a_robot_must_know(tmp_path: Path) -> None:
    env, path = Odd(), tmp_path / "policy.onnx"
    example.write_onnx(path, exported_policy(fast_learner(env), env, {"task": 7}, (START, 3)))
    texts = session(path).get_modelmeta().custom_metadata_map
    said = {name: json.loads(text) for name, text in texts.items()}
    assert said["observations"][1] == "-1 * qpos[0] x"
    assert said["actuators"] == ["right_motor", "left_motor"]
    assert (said["lower"], said["upper"]) == ([-2.0, -2.0], [2.0, 2.0])
    assert said["observation_upper"] == [None, 1.0, None, None, None, None]
    assert (said["control_period"], said["horizon"], said["task"]) == (0.01, 200, 7)
    assert (said["latent_mean"], said["updates"]) == ([0.5, -1.0], 3)
    np.testing.assert_allclose(said["latent_std"], np.exp([-0.25, 0.125]))
    np.testing.assert_allclose(said["action_std"], [0.3, 0.3], rtol=1e-6)
    assert said["is_noisy"] == {"explore": True, "deploy": False}


def test_the_program_converts_an_exported_file_and_refuses_a_search(tmp_path: Path) -> None:
    source, target = str(tmp_path / "wheeled.npz"), tmp_path / "wheeled.onnx"
    assert cli.run(["export", "wheeled", source, "--upper", "1.5"]) == 0
    program = [sys.executable, example.__file__]
    done = subprocess.run(
        [*program, source, str(target)], check=True, capture_output=True, text=True
    )
    assert "right_motor, 2 * action, limits -2 to 1.5" in done.stdout
    feed = {"observation": np.zeros((1, 12), np.float32), "z": np.full((1, 2), 9.0, np.float32)}
    assert session(target).run(None, feed)[0].max() <= 1.5
    search = exported_policy(fast_learner(), Point(), {}, search=(PRIOR, SearchSettings()))
    write_policy(source, search)
    done = subprocess.run(
        [*program, source, str(target)], capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "a network cannot search" in done.stderr
