"""What can be exported, what is refused, and what the file says."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from runtime.robot import constant, fast_learner, play, policy_file

from maesn.context import Latent, LatentContext
from maesn.envs import AnyEnv, Point, Wheeled
from maesn.inner.adaptation import Adaptation, InnerStep
from maesn.inner.advantage import AdvantageEstimator
from maesn.learners import PRESETS, Problem
from maesn.policies import GaussianMLP
from maesn.runs.export import exported_policy, probe_actuators, write_policy
from maesn.runtime import Explorer


def preset(name: str, **settings: Any) -> Any:
    """The fast learner of an untrained preset."""
    learner = PRESETS[name](policy=GaussianMLP((4,)), meta_batch_size=1, **settings)
    return learner.fast_learner(learner.init(jax.random.key(0), Problem(2, 2, 1)))


def test_the_file_holds_plain_arrays_and_json(tmp_path: Path) -> None:
    with np.load(policy_file(tmp_path), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    metadata = json.loads(str(arrays.pop("metadata")))
    assert (metadata["format"], metadata["version"]) == ("maesn-policy", 2)
    assert all(array.dtype.kind in "fi" for array in arrays.values())


def test_the_robot_knows_what_the_policy_is_for(tmp_path: Path) -> None:
    found = Explorer.load(policy_file(tmp_path, Wheeled())).exported
    assert (found.observation_size, found.action_size, found.latent_size) == (12, 2, 2)
    assert found.description["family"] == "wheeled"
    assert found.description["horizon"] == 200
    assert found.description["control_period"] == 0.01
    assert found.description["run"] == "a test"


def test_learned_step_sizes_are_exported() -> None:
    rule = exported_policy(fast_learner(), Point(), {}).rule
    np.testing.assert_allclose(rule.mean_step, [1.3, 0.4], rtol=1e-6)
    np.testing.assert_allclose(rule.log_std_step, [0.7, -0.2], rtol=1e-6)


def test_fixed_step_sizes_and_the_schedule_are_exported() -> None:
    rule = exported_policy(preset("latent_space"), Point(), {}).rule
    assert rule.mean_step.tolist() == rule.log_std_step.tolist() == [1.0, 1.0]
    assert [rule.scale(update) for update in range(5)] == [1, 1, 1, 0.5, 0.25]


def test_an_adapted_latent_is_where_the_robot_starts(tmp_path: Path) -> None:
    start = Latent(jnp.asarray([0.5, -1.0]), jnp.asarray([-0.25, 0.125]))
    write_policy(tmp_path / "policy.npz", exported_policy(fast_learner(), Point(), {}, (start, 3)))
    explorer = Explorer.load(tmp_path / "policy.npz")
    assert explorer.latent_mean.tolist() == [0.5, -1.0]
    np.testing.assert_allclose(explorer.latent_std, np.exp([-0.25, 0.125]))
    assert explorer.update == 3
    play(explorer, 2, constant(1.0))
    explorer.adapt()
    assert explorer.update == 4
    explorer.save(tmp_path / "saved.npz")
    assert Explorer.load(tmp_path / "saved.npz").update == 4


def test_an_adapted_latent_of_another_size_is_refused() -> None:
    start = Latent(jnp.zeros(3), jnp.zeros(3))
    with pytest.raises(ValueError, match="have 3 components, but the policy's z has 2"):
        exported_policy(fast_learner(), Point(), {}, (start, 1))


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


@pytest.mark.parametrize(("env", "limit"), [(Point(), 1.0), (Wheeled(), 2.0)])
def test_the_controls_are_read_off_the_environment(env: AnyEnv, limit: float) -> None:
    found = probe_actuators(env)
    assert found.offset.tolist() == [0.0, 0.0]
    assert found.scale.tolist() == [limit, limit]
    assert found.lower.tolist() == [-limit, -limit]
    assert found.upper.tolist() == [limit, limit]


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


class Swapped(Point):
    """A point whose second control belongs to its first action."""

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return jnp.clip(action[::-1], -1.0, 1.0)


class Squashed(Point):
    """A point whose controls are a smooth function of its actions."""

    def control(self, action: Float[Array, " action"]) -> Float[Array, " 2"]:
        return jnp.tanh(action)


@pytest.mark.parametrize("env", [Swapped(), Squashed()])
def test_controls_of_another_form_are_refused(env: AnyEnv) -> None:
    with pytest.raises(ValueError, match="for each actuator, but the action"):
        probe_actuators(env)
