"""What `MjxEngine` moves and refuses. `tests/long/physics` has the shipped robots."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from physics.accelerated import ROD

from maesn.physics import EngineError, PhysicsError, load_model
from maesn.physics.mjx import MjxEngine


def test_a_margin_that_cannot_be_kept_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rod.xml"
    path.write_text(ROD.format(rod='type="cylinder" size="0.02 0.04" mass="1"'), encoding="utf-8")
    with pytest.raises(ValueError, match="cannot be moved by the engine `mjx`") as refusal:
        MjxEngine(path)
    assert "engine `native`" in str(refusal.value)


def test_fields_that_cannot_differ_are_refused_by_name() -> None:
    engine, model = MjxEngine("wheeled"), load_model("wheeled")
    rough = np.ones((2, model.nv))
    with pytest.raises(ValueError, match="`model_fields` cannot hold dof_frictionloss"):
        engine.dynamics({"dof_frictionloss": rough, "dof_damping": rough})
    with pytest.raises(ValueError, match=r"must name fields of `mujoco.MjModel`.*'body_mas'"):
        engine.dynamics({"body_mas": rough})
    with pytest.raises(ValueError, match=r"`dof_damping` must have the shape \(2, 6\)"):
        engine.dynamics({"dof_damping": rough[:, :5]})
    rough[1, 2] = np.nan
    with pytest.raises(PhysicsError, match="simulation 1: `dof_damping` must be finite"):
        engine.dynamics({"dof_damping": rough})


def test_what_the_engine_lacks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"`readings` of the engine `mjx` .* got 'energy'"):
        MjxEngine("wheeled", ("qpos", "energy"))
    path = tmp_path / "implicit.xml"
    path.write_text(
        ROD.format(rod='size="0.1"').replace("<option", '<option integrator="implicit"')
    )
    with pytest.raises(ValueError, match="IMPLICIT"):
        MjxEngine(path)


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(EngineError, match=r"pip install -e '\.\[gpu\]'"):
        MjxEngine("wheeled")
