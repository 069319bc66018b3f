"""The model that a file is about, which it names as `ROBOT`."""

import mujoco
import pytest

from maesn.physics import load_model


@pytest.fixture(scope="module")
def model(request: pytest.FixtureRequest) -> mujoco.MjModel:
    return load_model(request.module.ROBOT)


@pytest.fixture
def data(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data
