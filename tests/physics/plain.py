"""Episodes of the wheeled robot on `NativeSimulator`, and the same ones on plain MuJoCo."""

import mujoco
import numpy as np

from maesn.physics import NativeSimulator, Readings

NUM_SIMULATIONS, STEPS = 12, 200  # whole episodes
STATE = ("qpos", "qvel")


def start(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    shape = (NUM_SIMULATIONS, 6)
    return 0.01 * generator.normal(size=shape), 0.1 * generator.normal(size=shape)


def controls(seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2, 2, size=(STEPS, NUM_SIMULATIONS, 2))


def play(simulator: NativeSimulator, seed: int = 0, **options: dict) -> list[Readings]:
    readings = [simulator.reset(*start(seed), **options)]
    return readings + [simulator.step(control) for control in controls()]


def plain(
    models: list[mujoco.MjModel], names: tuple[str, ...], frame_skip: int = 1
) -> list[Readings]:
    """The same episodes with `mj_step`, and all that is derived from the state computed again."""
    return plain_episodes(models, *start(), controls(), names, frame_skip)


def plain_episodes(
    models: list[mujoco.MjModel],
    qpos: np.ndarray,
    qvel: np.ndarray,
    control: np.ndarray,
    names: tuple[str, ...],
    frame_skip: int = 1,
) -> list[Readings]:
    """One episode on each model, one after the other; `control` is `[time, simulation, ...]`."""
    begins = zip(models, qpos, qvel, control.swapaxes(0, 1), strict=True)
    episodes = [_episode(*begin, names, frame_skip) for begin in begins]
    return [
        {name: np.stack([moment[name] for moment in moments]) for name in names}
        for moments in zip(*episodes, strict=True)
    ]


def _episode(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    qvel: np.ndarray,
    control: np.ndarray,
    names: tuple[str, ...],
    frame_skip: int,
) -> list[Readings]:
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    moments = [_derived(model, data, names)]
    for row in control:
        data.ctrl[:] = row
        mujoco.mj_step(model, data, frame_skip)
        moments.append(_derived(model, data, names))
    return moments


def _derived(model: mujoco.MjModel, data: mujoco.MjData, names: tuple[str, ...]) -> Readings:
    """What follows from the state. Contact forces take a call of their own."""
    mujoco.mj_forward(model, data)
    if "cfrc_ext" in names:
        data.cfrc_ext[:] = np.nan  # whoever does not compute them shows it
        mujoco.mj_rnePostConstraint(model, data)
    return {name: getattr(data, name).copy() for name in names}


def assert_equal(got: list[Readings], expected: list[Readings]) -> None:
    assert len(got) == len(expected)
    for step, (one, other) in enumerate(zip(got, expected, strict=True)):
        assert one.keys() == other.keys()
        for name in one:
            np.testing.assert_array_equal(one[name], other[name], f"{name}, step {step}")
