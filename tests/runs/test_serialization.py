"""Settings as JSON: what goes in comes out, and nothing else does."""

import json
from typing import Any

import equinox as eqx
import pytest

from maesn import maesn
from maesn.context import BiasContext, LatentContext
from maesn.inner.adaptation import Adaptation, InnerStep, StepSchedule
from maesn.learners import PRESETS, AbstractMetaLearner
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.learners.policy_steps import ProximalStep
from maesn.numerics.minibatch_descent import MinibatchDescent
from maesn.numerics.trust_region import TrustRegion
from maesn.policies import AbstractPolicySettings, GaussianMLP, HyperRecurrent
from maesn.serialization import digest_of_document, from_json, replaced, to_json

OTHERS = {
    "sizes": maesn(policy=GaussianMLP(hidden_sizes=(), initial_std=0.5)),
    "bias": maesn(context=BiasContext(size=0)),
    "pathwise": maesn(context=LatentContext(gradient="reparameterized", kl_weight=1e-30)),
    "thirds": maesn(
        outer=TrustRegionOuterStep(TrustRegion(max_kl=1 / 3)), schedule=StepSchedule(5, 0.1)
    ),
}
LEARNERS = {name: preset() for name, preset in PRESETS.items()} | OTHERS


def through_a_file(module: eqx.Module) -> eqx.Module:
    return from_json(json.loads(json.dumps(to_json(module), allow_nan=False)), type(module))


@pytest.mark.parametrize("name", LEARNERS)
def test_a_learner_comes_back_equal(name: str) -> None:
    learner = LEARNERS[name]
    back = through_a_file(learner)
    assert type(back) is type(learner)
    assert back == learner
    assert to_json(back) == to_json(learner)


def test_a_slot_is_filled_by_the_name_of_a_type() -> None:
    changes = {"policy.hidden_size": 8, "policy.type": "HyperRecurrent", "trial_episodes": 4}
    expected = PRESETS["rl2"](policy=HyperRecurrent(hidden_size=8), trial_episodes=4)
    assert replaced(PRESETS["rl2"](), changes) == expected
    with pytest.raises(ValueError, match="HyperRecurent"):
        replaced(PRESETS["rl2"](), {"policy.type": "HyperRecurent"})
    with pytest.raises(ValueError, match=r"`policy\.type`: `RecurrentPolicy` has no defaults"):
        replaced(PRESETS["rl2"](), {"policy.type": "RecurrentPolicy"})


def test_a_type_brings_the_slots_inside_of_it() -> None:
    changes = {
        "policy_step.descent.epochs": 3,
        "policy_step.descent.type": "MinibatchDescent",
        "policy_step.type": "ProximalStep",
    }
    step = ProximalStep(descent=MinibatchDescent(epochs=3))
    assert replaced(PRESETS["rl2"](), changes) == PRESETS["rl2"](policy_step=step)


def test_different_settings_have_different_digests() -> None:
    documents = map(to_json, LEARNERS.values())
    assert len(set(map(digest_of_document, documents))) == len(LEARNERS)


def test_one_and_one_point_zero_are_the_same_setting() -> None:
    decimal = maesn(adaptation=Adaptation(context=InnerStep(1.0)))
    # As a user may write it: nothing checks the type of a setting outside of these tests.
    whole = eqx.tree_at(lambda learner: learner.adaptation.context.initial_size, decimal, 1)
    assert json.dumps(to_json(whole)) == json.dumps(to_json(decimal))
    document = to_json(decimal)
    document["adaptation"]["context"]["initial_size"] = 1
    back = from_json(document, AbstractMetaLearner)
    assert back == decimal
    assert type(back.adaptation.context.initial_size) is float


class Foreign(AbstractPolicySettings):
    """Settings of a user's own, at the top of a module that is imported."""

    width: int = 3

    def init(self, *_: Any) -> Any:
        """Make nothing."""


def test_settings_of_a_users_own_come_back_by_their_module() -> None:
    learner = maesn(policy=Foreign(5))
    assert to_json(learner)["policy"]["type"] == f"{__name__}:Foreign"
    assert through_a_file(learner) == learner


def test_settings_that_no_file_could_name_are_not_stored() -> None:
    class Hidden(AbstractPolicySettings):
        def init(self, *_: Any) -> Any:
            """Make nothing."""

    with pytest.raises(ValueError, match="Hidden"):
        to_json(maesn(policy=Hidden()))


def altered(**changes: Any) -> dict[str, Any]:
    document = to_json(maesn()) | changes
    return {name: value for name, value in document.items() if value != "drop"}


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"type": "os.system"}, "os.system"),
        ({"type": "drop"}, "None"),
        ({"type": ["Adaptation"]}, "Adaptation"),
        ({"context": {"type": "NoContext", "size": 2}}, "size"),
        ({"schedule": "drop"}, "schedule"),
        ({"lr": 0.1}, "lr"),
        ({"meta_batch_size": "20"}, "meta_batch_size"),
        ({"meta_batch_size": 20.0}, "meta_batch_size"),
        ({"meta_batch_size": True}, "meta_batch_size"),
        ({"meta_batch_size": 0}, "meta_batch_size"),
        ({"type": "AbstractMetaLearner"}, "AbstractMetaLearner"),
        ({"type": "os:system"}, "os:system"),
        ({"context": to_json(TrustRegion())}, "AbstractContextSettings"),
        (
            {"policy": {"type": "GaussianMLP", "hidden_sizes": [8, "8"], "initial_std": 1.0}},
            r"hidden_sizes\[1\]",
        ),
        ({"context": to_json(LatentContext()) | {"gradient": "exact"}}, "LatentContext.gradient"),
    ],
)
def test_a_document_that_is_not_ours_is_refused_by_name(
    changes: dict[str, Any], named: str
) -> None:
    with pytest.raises(ValueError, match=named):
        from_json(altered(**changes), AbstractMetaLearner)
