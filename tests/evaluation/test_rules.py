"""Rules and what is added to them, from the command line to the table."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from small_runs import tiny_maesn, tiny_settings

from maesn import BonusFastLearner, FineTuning, api, cli
from maesn.envs import point
from maesn.evaluation.evaluation import Evaluation
from maesn.learners import PRESETS, CuriosityBonus
from maesn.learners.gradient.fast_learner import GradientFastLearner
from maesn.reporting.reading import read_adaptation
from maesn.rules import (
    FixedAgents,
    GradientRule,
    NoAdaptation,
    SearchRule,
    ThenTrpo,
    Trained,
    VimeBonus,
    from_text,
    written_out,
)
from maesn.runs.run import Run
from maesn.storage import RunError

BUDGET = ["--episodes", "9", "--episodes-per-update", "3"]
FEW = {"episodes": 6, "episodes_per_update": 3}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("rules") / "run"
    Run.create(directory, tiny_maesn(), tiny_settings())
    return directory


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("goals") / "few.npz"
    np.savez(path, goal=np.float32([[0.0, 2.0], [2.0, 0.0]]))
    return str(path)


def rows(table: Path) -> list[str]:
    return table.read_text().splitlines()


def test_fine_tuning_has_a_table_of_its_own(trained: Path, few: str, tmp_path: Path) -> None:
    plain = api.adapt(trained, Evaluation(few, episodes=60, episodes_per_update=20))
    budget = ["--episodes", "60", "--episodes-per-update", "20"]
    command = ["adapt", str(trained), "--tasks", few, *budget, "--then", "trpo", "after=20"]
    assert cli.run(command) == 0
    (tuned,) = (trained / "adaptation").glob("file-few-*-sparse-20-episodes-then-trpo-*.csv")
    # The same until the policy is tuned: after 0 and 20 episodes.
    assert rows(plain.table)[:3] == rows(tuned)[:3]
    assert rows(plain.table)[4] != rows(tuned)[4]


def test_other_step_sizes(trained: Path, few: str) -> None:
    asked = {"tasks": few, "episodes": 9, "episodes_per_update": 3}
    rules = [None, "gradient step_scale=2", "gradient full_steps=3"]
    done = [
        api.adapt(trained, rule=None if rule is None else from_text("rule", rule), **asked)
        for rule in rules
    ]
    assert len({one.table for one in done}) == 3
    plain, doubled, paced = (np.load(one.latents)["mean"] for one in done)  # [task, update, z]
    # Up to the first update, in which the same episodes are learned from with steps of two sizes.
    np.testing.assert_allclose(doubled[:, 1], 2 * plain[:, 1], rtol=1e-5)
    # Steps 1, 1, 1/2 and steps 1, 1, 1: what differs is the third.
    np.testing.assert_array_equal(paced[:, :3], plain[:, :3])
    third, whole = (kept[:, 3] - kept[:, 2] for kept in (plain, paced))
    np.testing.assert_allclose(whole, 2 * third, rtol=1e-4, atol=1e-6)


def test_latents_may_start_wider(trained: Path, few: str, tmp_path: Path) -> None:
    run = Run.open(trained)
    trained_as = Trained(run.learner, run.latest_state())
    learner = GradientRule(start_std=3.0).fast_learner(trained_as, run.env())
    start = learner.init(jax.random.split(jax.random.key(0), 2)).agents.context
    np.testing.assert_allclose(np.exp(start.log_std), 3.0, rtol=1e-6)
    np.testing.assert_array_equal(start.mean, 0.0)
    without = tmp_path / "without"
    Run.create(without, PRESETS["maml"](meta_batch_size=4), tiny_settings(method="maml"))
    with pytest.raises(RunError, match="`start_std` needs a method with a latent"):
        api.adapt(without, tasks=few, rule=GradientRule(start_std=3.0))


def test_settings_that_differ_have_files_that_differ() -> None:
    scales = (1.0, 2.0, 0.5, 0.12345678, 0.12345679)
    suffixes = [Evaluation(rule=GradientRule(step_scale=scale)).suffix for scale in scales]
    assert suffixes[0] == Evaluation().suffix == ""
    assert len(set(suffixes)) == len(scales)
    assert suffixes[1].startswith("-steps-2-")


@pytest.mark.parametrize("name", ["rl2", "oracle"])
def test_a_rule_that_does_not_fit_the_method_is_refused(
    tmp_path: Path, few: str, name: str
) -> None:
    run = Run.create(tmp_path / "run", PRESETS[name](meta_batch_size=4), tiny_settings(method=name))
    with pytest.raises(RunError, match=f"`{name}` cannot be adapted like this: .*a gradient"):
        api.adapt(run, tasks=few, rule=GradientRule())


def test_the_rule_gradient_is_what_the_method_does_by_itself(trained: Path, few: str) -> None:
    own, named = (
        api.adapt(trained, tasks=few, rule=rule, **FEW) for rule in (None, GradientRule())
    )
    np.testing.assert_array_equal(own.curves.mean_return, named.curves.mean_return)


def test_without_adaptation_the_agents_stay(trained: Path, few: str) -> None:
    done = api.adapt(trained, tasks=few, rule=NoAdaptation(), **FEW)
    assert np.all(done.outcome.contexts.mean == 0)
    # Unless a budget is given, no episodes are played but those that judge the deployed agent.
    usual = api.adapt(trained, tasks=few, rule=NoAdaptation(), num_tasks=2)
    assert np.isnan(usual.outcome.explored.mean_return).all()
    assert usual.curves.mean_return.shape == (2, 1)
    assert [row.split(",")[:4] for row in rows(usual.table)[1:]] == [
        [str(task), "0", "0", "deploy"] for task in range(2)
    ]
    read = read_adaptation(usual.table)
    np.testing.assert_allclose(read.mean_return, usual.curves.mean_return)
    run = Run.open(trained)
    trained_as = Trained(run.learner, run.latest_state())
    learner = Evaluation(rule=NoAdaptation()).fast_learner(trained_as, "maesn", run.env())
    assert isinstance(learner, FixedAgents)
    assert not learner.capabilities.learns_from_reward


def test_deployed_agents_are_judged_on_fresh_episodes(trained: Path, few: str) -> None:
    done = api.adapt(trained, tasks=few, deploy_episodes=4, out=None, **FEW)
    plain = api.adapt(trained, tasks=few, **FEW)
    # What is explored and learned from is the same, whether anything is deployed or not.
    np.testing.assert_array_equal(
        done.outcome.explored.mean_return, plain.outcome.explored.mean_return
    )
    np.testing.assert_array_equal(done.outcome.contexts.mean, plain.outcome.contexts.mean)
    assert plain.outcome.deployed is None
    assert done.curves is done.outcome.deployed
    assert done.curves.mean_return.shape == (2, 3)
    assert not np.array_equal(done.curves.mean_return, plain.curves.mean_return)


def test_the_record_says_by_which_rule(trained: Path, few: str) -> None:
    curiosity = CuriosityBonus(updates=3)
    added = (ThenTrpo(after=20), VimeBonus(curiosity))
    asked = Evaluation(few, episodes=40, episodes_per_update=20, wrappers=added)
    done = api.adapt(trained, asked)
    record = json.loads(done.table.with_suffix(".settings.json").read_text())
    for settings in (ThenTrpo(after=20), curiosity):
        for name, value in vars(settings).items():
            assert f"{name}={written_out(value)}" in record["rule"]


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_the_weights_learn_from_the_bonus_as_well(trained: Path, order: slice) -> None:
    run, env = Run.open(trained), point.make_env()
    added = (ThenTrpo(after=20), VimeBonus())[order]
    trained_as = Trained(run.learner, run.latest_state())
    asked = Evaluation(wrappers=added, episodes=40, episodes_per_update=20)
    both = asked.fast_learner(trained_as, "maesn", env)
    assert isinstance(both, BonusFastLearner)
    assert isinstance(both.learner, FineTuning)
    assert isinstance(both.learner.learner, GradientFastLearner)


def test_what_cannot_be_given_is_refused_by_name(trained: Path, tmp_path: Path) -> None:
    recurrent = Run.create(tmp_path / "rl2", PRESETS["rl2"](), tiny_settings())
    for added, reason in (
        (ThenTrpo(), "`learner` must not be"),
        (VimeBonus(), "`learner` must learn"),
    ):
        with pytest.raises(RunError, match=f"`rl2` cannot be adapted like this: {reason}"):
            api.adapt(recurrent, wrappers=(added,), episodes=550)
    for run, named, asked in (
        (trained, "more than `after`", {"wrappers": (ThenTrpo(),)}),
        (trained, "`after` must be a multiple", {"wrappers": (ThenTrpo(after=30),)}),
        (
            trained,
            "more than `after`",
            {"rule": SearchRule(), "episodes": 20, "wrappers": (ThenTrpo(after=10),)},
        ),
        (recurrent, "`deploy_episodes` must be 0 or", {"deploy_episodes": 7}),
        (trained, "at least 2 episodes", {"episodes_per_update": 1}),
    ):
        with pytest.raises(RunError, match=named):
            api.adapt(run, **asked)
    with pytest.raises(TypeError, match="updates"):
        api.adapt(trained, updates=3)


@pytest.mark.parametrize(
    ("text", "full"),
    [
        ("gradient", "GradientRule(step_scale=1.0, full_steps=None, start_std=1.0)"),
        (
            "search exploration=1 any_reward=true",
            "SearchRule(acquisition='ucb', exploration=1.0, draws=8, draw_std=0.2, residual=0.1, "
            "length_scale=1.0, jumps=True, familiar=0.7, prior='', any_reward=True)",
        ),
    ],
)
def test_a_rule_written_out_in_full_is_what_names_jobs(text: str, full: str) -> None:
    assert written_out(from_text("rule", text)) == full


def test_rules_as_text() -> None:
    assert from_text("rule", "gradient") == GradientRule()
    assert from_text("rule", "gradient step_scale=2 full_steps=3") == GradientRule(2.0, 3)
    assert from_text("then", "trpo max_kl=0.02 after=100") == ThenTrpo(0.02, 100)
    assert from_text("bonus", "vime curiosity.weight=0.5") == VimeBonus(CuriosityBonus(0.5))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gradeint", "one of gradient, search, none"),
        ("gradient step=2", "one of step_scale"),
        ("gradient step_scale", "NAME=VALUE"),
        ("gradient step_scale=fast", "float"),
        ("gradient step_scale=-1", "positive"),
        ("nowhere:Rule", "importable"),
        ("json:dumps", "`maesn.AbstractRule`"),
    ],
)
def test_mistakes_in_the_text_of_a_rule_get_a_sentence(text: str, message: str) -> None:
    with pytest.raises(RunError) as refused:
        from_text("rule", text)
    assert message in str(refused.value)
