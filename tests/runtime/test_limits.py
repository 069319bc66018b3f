"""What a robot is sent and shown is what the simulation lets through, and nothing is guessed."""

import re
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from carts import MODEL, Cart, CartTask
from gymnasium.wrappers import TimeLimit
from jaxtyping import Array
from runtime.robot import fast_learner, policy_file
from strangers import Arm, Skip

from maesn.axes import Readings
from maesn.envs import FAMILIES, Ant, AnyEnv, BlockPush, Wheeled, ant, blockpush
from maesn.envs.foreign import gymnasium_family
from maesn.evaluation.exporting import Stated, exported_policy
from maesn.physics import NativeSimulator
from maesn.runs.probing import probe_sensors
from maesn.runtime import Explorer
from maesn.runtime.table import facts


def make_arm(task: np.ndarray, reward: str) -> Any:
    return Skip(TimeLimit(Arm(0.05, 20), 10), 4)


LIMITED = '<motor name="push" joint="rail" ctrlrange="-0.2 0.3" ctrllimited="true"/>'
FREE = '<motor name="push" joint="rail"/>'
IGNORED = MODEL.replace("<option ", '<option><flag clampctrl="disable"/></option><option ')
TASK = CartTask(np.float32(0.0), np.float32(1.0))


class Driven(Cart):
    """A cart whose control is its action, clipped to a range or not."""

    name: ClassVar[str] = "driven"
    model: ClassVar[str] = MODEL.format(actuator=LIMITED)
    reach: float = np.inf

    def control(self, action: Array) -> Array:
        return jnp.clip(action, -self.reach, self.reach)


def on_model(xml: str, kind: type[Driven] = Driven, **fields: Any) -> Driven:
    return type("Other", (kind,), {"model": xml})(**fields)


def export(env: AnyEnv, task: Any = TASK, **stated: Any) -> Any:
    return exported_policy(fast_learner(env), env, {}, task=task, stated=Stated(**stated))


@pytest.mark.parametrize(
    ("reach", "stated", "limits"),
    [
        (np.inf, {}, (-0.2, 0.3)),  # the model is the tightest
        (0.25, {}, (-0.2, 0.25)),  # so is each for one side
        (0.1, {}, (-0.1, 0.1)),
        (np.inf, {"upper": 0.05}, (-0.2, 0.05)),
        (np.inf, {"lower": -1.0, "upper": [1.0]}, (-0.2, 0.3)),  # nothing is widened
    ],
)
def test_the_tightest_limits_hold(reach: float, stated: Any, limits: Any) -> None:
    exported = export(Driven(reach=reach), **stated)
    actuators = exported.actuators
    np.testing.assert_allclose([*actuators.lower, *actuators.upper], limits, rtol=1e-6)
    assert actuators.names == ("push",)
    explorer = Explorer(exported, seed=0)
    explorer.begin_episode()
    sent = np.array([explorer.act([0.0, 0.0]) for _ in range(100)])
    assert actuators.lower[0] <= sent.min() < sent.max() <= actuators.upper[0]


def test_the_engine_clips_to_the_limits_that_the_robot_has() -> None:
    """Two controls beyond the limit move the cart as the limit itself does."""
    simulator = NativeSimulator(Driven.model, 3)
    simulator.reset(np.zeros((3, 1)), np.zeros((3, 1)))
    speed = simulator.step(np.array([[0.3], [5.0], [0.29]]))["qvel"][:, 0]
    assert speed[0] == speed[1] > speed[2]


@pytest.mark.parametrize("xml", [MODEL.format(actuator=FREE), IGNORED.format(actuator=LIMITED)])
def test_limits_that_nobody_knows_are_asked_for(xml: str) -> None:
    env = on_model(xml)
    with pytest.raises(
        ValueError, match=r"control of actuator 0 may be anything from -inf to inf: .*--lower"
    ):
        export(env)
    with pytest.raises(ValueError, match="Where there is no limit, say inf"):
        export(env, lower=-1.0)
    assert export(env, lower=-1.0, upper=2.0).actuators.upper.tolist() == [2.0]
    assert export(env, lower=-np.inf, upper=np.inf).actuators.upper.tolist() == [np.inf]
    with pytest.raises(ValueError, match="leave no control"):
        export(env, lower=1.0, upper=-1.0)


class Varied(Driven):
    """Tasks with limits and time steps of their own."""

    field: str = ""

    def model_fields(self, task: CartTask) -> dict[str, Array]:
        return {self.field: jnp.zeros(2)}


def test_limits_and_periods_that_differ_between_tasks_are_asked_for() -> None:
    limits, period = Varied(field="actuator_ctrlrange"), Varied(field="opt.timestep")
    with pytest.raises(ValueError, match="limits of the actuators differ between the tasks"):
        export(limits)
    assert export(limits, lower=-0.1, upper=0.1).actuators.upper.tolist() == [0.1]
    with pytest.raises(ValueError, match=r"the time step differs between the tasks: .*--control-p"):
        export(period)
    assert export(period, control_period=0.5).description["control_period"] == 0.5


def test_the_period_of_the_simulation_holds() -> None:
    assert export(Driven()).description["control_period"] == 0.01
    assert export(Driven(), control_period=0.01).description["control_period"] == 0.01
    with pytest.raises(ValueError, match=r"control period of 0\.01 s, not 0\.02 s"):
        export(Driven(), control_period=0.02)


class Odd(Wheeled):
    """A robot with sensors in other units, clipped, wrapped, and in another order."""

    observation_size: int = 6

    def observe(self, readings: Readings) -> Array:
        qpos, qvel = readings["qpos"], readings["qvel"]
        return jnp.stack(
            [
                10.0 * qvel[5] + 2.0,
                jnp.clip(-qpos[0], -0.5, 1.0),
                (qpos[3] + jnp.pi) % (2 * jnp.pi) - jnp.pi,
                qpos[0] + qpos[1],
                jnp.sin(qpos[3]),
                jnp.zeros(()),
            ]
        )


def test_observations_are_named_after_what_they_copy_and_clipped_alike() -> None:
    env, unlimited = Odd(), [np.inf] * 4
    sensors = probe_sensors(env, None)
    assert sensors.names == (
        "10 * qvel[5] left_wheel + 2",
        "-1 * qpos[0] x",
        *["computed by `wheeled`"] * 4,
    )
    assert sensors.upper.tolist() == [np.inf, 1.0, *unlimited]
    assert sensors.lower.tolist() == [-np.inf, -0.5, *np.negative(unlimited)]
    explorer = Explorer(export(env, None), seed=0)
    explorer.begin_episode()
    explorer.act([3.0, 7.0, 3.0, 3.0, 3.0, 3.0], explore=False)
    explorer.act([3.0, 1.0, 3.0, 3.0, 3.0, 3.0], explore=False)
    played = explorer.end_episode([0.0, 0.0])
    assert played.observations[:, 1].tolist() == [1.0, 1.0]
    np.testing.assert_array_equal(*played.controls)


def test_the_families_name_their_sensors() -> None:
    walker = probe_sensors(Ant(), ant.task_set("training")[0])
    assert walker.names[7] == "qpos[7] hip_1"
    assert walker.names[29] == "cfrc_ext[0, 0]"
    assert walker.names[113] == "computed by `ant`"
    assert walker.upper[28:31].tolist() == [np.inf, 1.0, 1.0]
    pusher = probe_sensors(BlockPush(variant="paper"), blockpush.task_set("training")[0])
    assert pusher.names[3] == "qpos[3] block_0_x + 0.2"
    assert pusher.names[-2:] == ("instruction[0]", "instruction[1]")
    point = FAMILIES["point"]
    assert probe_sensors(point.make_env(), point.task_set("training")[0]).names == (
        "qpos[0]",
        "qpos[1]",
    )


def test_actions_are_drawn_for_the_purposes_for_which_the_simulation_draws_them(
    tmp_path: Any,
) -> None:
    explorer = Explorer.load(policy_file(tmp_path), seed=0)
    for purpose, varies in (("explore", True), ("deploy", False)):
        explorer.begin_episode(explore=purpose == "explore")
        first, second = (explorer.act([0.1, 0.2]) for _ in range(2))
        assert (first != second).any() == varies
        drawn = [explorer.act([0.1, 0.2], explore=True) for _ in range(2)]
        assert (drawn[0] != drawn[1]).any()  # whoever calls may always choose
        explorer.discard()


def test_the_table_names_every_sensor_and_actuator_of_a_small_robot() -> None:
    table = dict(facts(export(Driven(reach=0.25))))
    assert table["observation 1"] == "qvel[0] rail"
    assert table["control 0"] == "push, 1 * action, limits -0.2 to 0.25"
    assert table["control period"] == "0.01 s"
    assert table["episode"] == "12 steps, 0.12 s"
    assert table["actions to deploy"] == "the mean"
    many = dict(facts(export(Ant(), None)))
    assert many["observation 29-112"] == "cfrc_ext[0, 0] ... cfrc_ext[13, 5], clip -1 to 1"
    assert not [line for line in many if re.fullmatch(r"observation \d+", line)]


def test_a_gymnasium_environment_that_repeats_actions_gives_its_period_and_limits() -> None:
    family = gymnasium_family("arm", make_arm, lambda stream, size: np.zeros((size, 1), np.float32))
    exported = export(family.make_env(), np.zeros(1, np.float32))
    assert exported.actuators.lower.tolist() == pytest.approx([-0.2, -0.4])
    assert exported.actuators.upper.tolist() == pytest.approx([0.2, 0.8])
    assert exported.description["control_period"] == pytest.approx(0.2)
    assert exported.description["horizon"] == 3  # four times ten steps of the arm's own clock
    table = dict(facts(exported))
    assert table["control 1"] == "0.2 + 0.6 * action, limits -0.4 to 0.8"
    assert table["episode"] == "3 steps, 0.6 s"
