"""What `NativeSimulator` refuses, and that no failure of the physics goes unnoticed."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from physics.plain import NUM_SIMULATIONS, STATE, assert_equal, controls, play, start

from maesn.physics import NativeSimulator, PhysicsError, Readings

# A mass on a motor that pushes it away from the origin: x grows by a factor 1e7 every step.
UNSTABLE = """
<mujoco>
  <option timestep="0.01" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator><general joint="x" biastype="affine" biasprm="0 1e11 0"/></actuator>
</mujoco>
"""


@pytest.fixture(autouse=True)
def _no_file_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    directory = tmp_path / "working_directory"
    directory.mkdir()
    monkeypatch.chdir(directory)
    yield
    assert not list(directory.iterdir())


@pytest.fixture
def unstable(tmp_path: Path) -> Path:
    path = tmp_path / "unstable.xml"
    path.write_text(UNSTABLE, encoding="utf-8")
    return path


def coast(simulator: NativeSimulator, actuators: int, steps: int) -> Readings:
    """Advance without any control."""
    control = np.zeros((simulator._num_simulations, actuators))
    for _ in range(steps):
        readings = simulator.step(control)
    return readings


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("nonfinite", ["raise", "report"])
def test_a_control_that_is_not_finite_is_refused(bad: float, nonfinite: str) -> None:
    simulator = NativeSimulator("wheeled", NUM_SIMULATIONS, nonfinite=nonfinite)
    undisturbed = play(simulator)
    simulator.reset(*start())
    control = controls()[0]
    control[[4, 7], 1] = bad
    with pytest.raises(PhysicsError, match="`control` must be finite") as caught:
        simulator.step(control)
    assert caught.value.simulation == 4
    assert_equal([simulator.step(controls()[0])], [undisturbed[1]])  # nothing had moved


@pytest.mark.parametrize("name", ["qpos", "qvel"])
def test_a_start_that_is_not_finite_is_refused(name: str) -> None:
    simulator = NativeSimulator("wheeled", NUM_SIMULATIONS, nonfinite="report")
    states = dict(zip(STATE, start(), strict=True))
    states[name][5, 0] = np.nan
    with pytest.raises(PhysicsError, match=f"`{name}` must be finite") as caught:
        simulator.reset(**states)
    assert caught.value.simulation == 5


def test_a_blow_up_is_seen_in_the_step_that_makes_it(unstable: Path) -> None:
    """MuJoCo would warn one step later, which a last step does not have."""
    simulator = NativeSimulator(unstable, 3)
    qvel, control = np.zeros((3, 1)), np.zeros((3, 1))
    qvel[2], control[2] = 9.95e9, 9.9e9  # together 1.0049e10
    simulator.reset(np.zeros((3, 1)), qvel)
    with pytest.raises(
        PhysicsError, match="the state must stay finite and below 1e\\+10"
    ) as caught:
        simulator.step(control)
    assert caught.value.simulation == 2


@pytest.mark.parametrize("readings", [STATE, (*STATE, "geom_xpos")])
def test_a_blow_up_is_raised_at_once_or_reported(unstable: Path, readings: tuple[str, ...]) -> None:
    qpos, blown = np.zeros((6, 1)), np.isin(np.arange(6), [1, 4])
    qpos[blown] = 1e-6
    simulator = NativeSimulator(unstable, 6, readings)
    simulator.reset(qpos, np.zeros((6, 1)))
    coast(simulator, actuators=1, steps=1)  # x = 1e-6 * 1e7
    with pytest.raises(PhysicsError, match="simulation 1: ") as caught:
        coast(simulator, actuators=1, steps=3)
    assert caught.value.simulation == 1
    with pytest.raises(PhysicsError):  # nobody can go on by accident
        coast(simulator, actuators=1, steps=1)
    simulator = NativeSimulator(unstable, 6, readings, nonfinite="report")
    simulator.reset(qpos, np.zeros((6, 1)))
    last = coast(simulator, actuators=1, steps=100)
    for name in readings:
        finite = np.isfinite(last[name].reshape(6, -1)).all(axis=1)
        np.testing.assert_array_equal(~finite, blown)
    np.testing.assert_array_equal(last["qpos"][~blown], 0)


def test_what_is_out_of_range_or_of_a_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match="`frame_skip` must be at least"):
        NativeSimulator("wheeled", 2, frame_skip=0)
    with pytest.raises(ValueError, match="geom_xpos"):
        NativeSimulator("wheeled", 2, ("qpos", "geom_xpo"))
    simulator = NativeSimulator("wheeled", 12)
    for shape in ((12, 3), (1, 2)):
        with pytest.raises(ValueError, match=r"`control` must have the shape \(12, 2\)"):
            simulator.step(np.zeros(shape))
    with pytest.raises(ValueError, match=r"`qvel` .* \(12, 6\), got"):
        simulator.reset(np.zeros((12, 6)), np.zeros((12, 5)))
