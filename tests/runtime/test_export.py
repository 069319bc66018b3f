"""What can be exported, what is refused, and what the file says."""

import dataclasses
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from runtime.robot import fast_learner

from maesn import cli
from maesn.context import LatentContext
from maesn.envs import AnyEnv, Point
from maesn.evaluation.exporting import exported_policy
from maesn.inner.adaptation import Adaptation, InnerStep
from maesn.inner.advantage import AdvantageEstimator
from maesn.learners import PRESETS, Problem
from maesn.policies import GaussianMLP
from maesn.runs.probing import probe_actuators


def preset(name: str, **settings: Any) -> Any:
    """The fast learner of an untrained preset."""
    learner = PRESETS[name](policy=GaussianMLP((4,)), meta_batch_size=1, **settings)
    return learner.fast_learner(learner.init(jax.random.key(0), Problem(2, 2, 1)))


def test_fixed_step_sizes_and_the_schedule_are_exported() -> None:
    rule = exported_policy(preset("latent_space"), Point(), {}).rule
    assert rule.mean_step.tolist() == rule.log_std_step.tolist() == [1.0, 1.0]
    assert [rule.scale(update) for update in range(5)] == [1, 1, 1, 0.5, 0.25]


def test_the_smallest_standard_deviation_holds() -> None:
    learner = fast_learner()
    sharp = eqx.tree_at(lambda fast: fast.policy.log_std, learner, jnp.full(2, -50.0))
    assert exported_policy(sharp, Point(), {}).policy.std.tolist() == [1e-6, 1e-6]


@pytest.mark.parametrize(
    "learner",
    [
        lambda: preset("maml"),
        lambda: preset("maml_bias"),
        lambda: preset("oracle"),
        lambda: preset("maml_bias_only"),
        lambda: preset("maesn", adaptation=Adaptation(InnerStep(0.1), InnerStep(1.0))),
        lambda: preset("maesn", context=LatentContext(gradient="reparameterized")),
        lambda: preset("maesn", adaptation=Adaptation(), inner_updates=0),
        lambda: preset("maesn", advantage=AdvantageEstimator(drifts=True)),
    ],
)
def test_what_has_no_closed_form_is_refused(learner: Any) -> None:
    with pytest.raises(ValueError, match=r"must adapt a latent alone.*`maesn` and `latent_space`"):
        exported_policy(learner(), Point(), {})


def test_the_latent_alone_of_a_method_that_adapts_more() -> None:
    everything = preset("maesn_theta")
    alone = dataclasses.replace(everything, adaptation=Adaptation(context=InnerStep(1.0)))
    assert exported_policy(alone, Point(), {}).latent_size == 2


class Unlimited(Point):
    """A point with shifted controls, limited on one side at most."""

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return jnp.minimum(jnp.asarray([0.5, 0.0]) - 3.0 * action, jnp.asarray([2.0, jnp.inf]))


def test_controls_may_be_shifted_reversed_and_unlimited() -> None:
    found = probe_actuators(Unlimited())
    assert found.offset.tolist() == [0.5, 0.0]
    np.testing.assert_allclose(found.scale, [-3.0, -3.0], rtol=1e-6)
    assert found.lower.tolist() == [-np.inf, -np.inf]
    assert found.upper.tolist() == [2.0, np.inf]


class Pushing(Point):
    """A point whose controls are at a limit at 0, or far beyond one."""

    offset: tuple[float, float] = (0.0, 0.0)
    scale: tuple[float, float] = (1.0, 1.0)
    lower: tuple[float, float] = (-1.0, -1.0)
    upper: tuple[float, float] = (1.0, 1.0)

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        asked = jnp.asarray(self.offset) + jnp.asarray(self.scale) * action
        return jnp.clip(asked, jnp.asarray(self.lower), jnp.asarray(self.upper))


@pytest.mark.parametrize(
    "form",
    [
        {"offset": (0, 2), "scale": (1, 1), "lower": (0, -1), "upper": (1, 1)},
        {"offset": (0, -1.3), "scale": (0.1, 0.3), "lower": (0, 0), "upper": (np.inf, np.inf)},
        {"offset": (0, 0), "scale": (-0.7, 0.37), "lower": (-np.inf, 0), "upper": (0, 100)},
        {"offset": (7, 30), "scale": (3, -10), "lower": (-1, -1), "upper": (1, 1)},
        {"offset": (5, 0), "scale": (0.1, 40), "lower": (-2, 0), "upper": (2, 0.2)},
        {"offset": (-40000, 0), "scale": (1, 1), "lower": (-1, 0), "upper": (1, 0.001)},
        {"offset": (1 - 1e-4, 1 - 1e-6), "scale": (0.37, 0.37), "lower": (-1, -1), "upper": (1, 1)},
        {"offset": (16.6, 57), "scale": (0.018, 0.027), "lower": (0, 0), "upper": (np.inf, np.inf)},
    ],
)
def test_controls_may_be_at_a_limit_in_the_middle(form: dict[str, tuple[float, float]]) -> None:
    wanted = {name: tuple(map(float, values)) for name, values in form.items()}
    found = probe_actuators(Pushing(**wanted))
    np.testing.assert_allclose(found.offset, wanted["offset"], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.scale, wanted["scale"], rtol=1e-4)
    assert (found.lower.tolist(), found.upper.tolist()) == (
        pytest.approx(wanted["lower"]),
        pytest.approx(wanted["upper"]),
    )


class Swapped(Point):
    """A point whose second control belongs to its first action."""

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return jnp.clip(action[::-1], -1.0, 1.0)


class Squashed(Point):
    """A point whose controls are a smooth function of its actions."""

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return jnp.tanh(action)


class Dead(Point):
    """A point with a dead zone far outside."""

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return jnp.where(jnp.abs(action) > 30.0, 0.0, action)


@pytest.mark.parametrize("env", [Swapped(), Squashed(), Dead()])
def test_controls_of_another_form_are_refused(env: AnyEnv) -> None:
    with pytest.raises(ValueError, match="for each actuator, but the action"):
        probe_actuators(env)


def test_the_command_shows_what_a_robot_is_sent_and_replaces_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["export", "wheeled", str(tmp_path / "wheeled.npz")]
    assert cli.run(["export", "wheeled", str(tmp_path / "wheeled.onnx")]) == cli.USAGE_ERROR
    assert "policy_to_onnx.py" in capsys.readouterr().err
    assert cli.run([*command, "--upper", "1.5"]) == 0
    said = capsys.readouterr().out
    assert "right_motor, 2 * action, limits -2 to 1.5" in said
    assert "control period       0.01 s" in said
    assert cli.run(command) == cli.USAGE_ERROR
    each = ["--lower", "-1", "-0.5", "--upper=inf", "--overwrite"]
    assert cli.run([*command, *each]) == 0
    assert "left_motor, 2 * action, limits -0.5 to 2" in capsys.readouterr().out
    for wrong in (["--lower"], ["--lower", "x"]):
        with pytest.raises(SystemExit):
            cli.run([*command, *wrong])
