"""Run directories: what they hold, and where they can be made."""

import dataclasses
from pathlib import Path

import jax
import pytest
from small_runs import create_tiny, tensors, tiny_maesn, tiny_settings

from maesn import api, cli
from maesn.context import LatentContext
from maesn.envs import FAMILIES
from maesn.envs.sources import resolve_family
from maesn.learners import PRESETS
from maesn.policies import CategoricalMLP
from maesn.runs.config import RunSettings
from maesn.runs.run import Run
from maesn.storage import LOCK, RunError

POINT = FAMILIES["point"]
BANDIT = "bernoulli_bandit:bandit"


def test_a_run_opens_as_it_was_created(tmp_path: Path) -> None:
    learner = tiny_maesn(context=LatentContext(kl_weight=0.3))
    settings = tiny_settings(variant="paper", reward="sparse", sparse_radius=0.25, seed=5)
    made = Run.create(tmp_path / "a" / "run", learner, settings)
    opened = Run.open(str(tmp_path / "a" / "run"))
    assert opened.learner == made.learner == learner
    assert opened.settings == made.settings == dataclasses.replace(settings, method="maesn")
    assert opened.family is made.family is POINT
    assert opened.directory == tmp_path / "a" / "run"
    assert opened.training_tasks.digest() == POINT.task_set("training").digest()
    env = opened.env()
    assert (env.variant, env.reward_kind, env.sparse_radius) == ("paper", "sparse", 0.25)


def test_a_new_run_starts_from_the_state_of_its_seed(tmp_path: Path) -> None:
    runs = [
        create_tiny(tmp_path / name, seed=seed) for name, seed in (("a", 1), ("b", 1), ("c", 2))
    ]
    assert [path.name for path in runs[0].checkpoints()] == ["iteration-000000.safetensors"]
    first, same, other = (tensors(run.checkpoints()[0]) for run in runs)
    assert first == same != other
    assert runs[0].latest().iteration == runs[0].latest().environment_steps == 0
    assert runs[0].latest_state().parameters.context_table.mean.shape == (100, 2)


def test_all_keys_of_a_run_differ(finished: Path) -> None:
    run = Run.open(finished)
    iterations = [0, 1, 2, 3, 299, 300, 2**32 - 1]
    keys = [jax.random.key_data(run.iteration_key(n)).tolist() for n in iterations]
    # Those that the untrained state splits its key into belong to no iteration either.
    split = jax.random.key_data(jax.random.split(run.iteration_key(2**32 - 1))).tolist()
    assert len({tuple(key) for key in [*keys, *split]}) == len(iterations) + 2


def test_a_run_trained_on_another_set_of_the_family(tmp_path: Path) -> None:
    run = create_tiny(tmp_path / "a", tasks="validation")
    assert run.training_tasks.digest() == POINT.task_set("validation").digest()
    assert Run.open(run.directory).task_set("training").digest() == run.training_tasks.digest()


def test_actions_of_another_kind_are_refused_before_there_is_a_directory(tmp_path: Path) -> None:
    directory = tmp_path / "run"
    with pytest.raises(RunError, match=r"`bandit` needs a policy of discrete actions.*Categorical"):
        create_tiny(directory, family=BANDIT)
    assert not directory.exists()
    discrete = tiny_maesn(policy=CategoricalMLP((4,)))
    with pytest.raises(RunError, match=r"`point` needs a policy of continuous .*GaussianMLP"):
        Run.create(directory, discrete, tiny_settings())
    assert Run.create(directory, discrete, tiny_settings(family=BANDIT)).learner == discrete


def test_the_command_gives_policies_that_choose_where_that_is_needed(tmp_path: Path) -> None:
    few = ["--family", BANDIT, "--iterations", "0", "--policy.hidden-sizes", "6"]
    assert cli.run(["train", "maesn", *few, "--run", str(tmp_path / "maesn")]) == 0
    assert Run.open(tmp_path / "maesn", BANDIT).learner.policy == CategoricalMLP((6,))
    rl2 = ["train", "rl2", "--family", BANDIT, "--iterations", "0", "--policy.hidden-size", "4"]
    assert cli.run([*rl2, "--run", str(tmp_path / "rl2")]) == 0
    assert Run.open(tmp_path / "rl2", BANDIT).learner.policy.action_kind == "discrete"


def test_a_run_without_a_directory_is_named_by_method_family_and_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    family = resolve_family(BANDIT)
    made = api.train(tiny_maesn(), RunSettings(method="rl2", iterations=0, seed=3), family=family)
    assert made.directory == Path("runs/maesn-bandit-3")
    assert isinstance(made.learner.policy, CategoricalMLP)


def test_trials_that_are_too_few_for_the_minibatches_are_refused(tmp_path: Path) -> None:
    directory, learner = tmp_path / "run", PRESETS["rl2"](meta_batch_size=2)
    with pytest.raises(RunError, match=r"`policy_step\.descent\.minibatches` is 8"):
        Run.create(directory, learner, tiny_settings(episodes_per_task=2))
    assert not directory.exists()


def test_a_directory_whose_making_was_killed_can_be_used(tmp_path: Path) -> None:
    (tmp_path / LOCK).touch()
    with pytest.raises(RunError, match="maesn train"):
        Run.open(tmp_path)
    assert create_tiny(tmp_path).directory == tmp_path
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["checkpoints", "config.json"]


def test_a_directory_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for place in ("file", "file/sub"):
        with pytest.raises(RunError, match="cannot work in"):
            create_tiny(tmp_path / place)


def test_no_run_there(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "missing"):
        with pytest.raises(RunError, match="maesn train"):
            Run.open(place)
