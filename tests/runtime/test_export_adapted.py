"""A robot that starts at an adapted latent: from `maesn adapt` to the runtime."""

import shutil
from pathlib import Path

import jax
import numpy as np
import pytest
from own_searches import BestOf
from small_runs import create_tiny

import maesn
from maesn import api, cli
from maesn.evaluation.running import Adapted
from maesn.runs.run import Run
from maesn.runtime import Explorer
from maesn.storage import RunError


@pytest.fixture(scope="module")
def adapted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Adapted]:
    """A run, and what adapting it to the test tasks has written."""
    directory = tmp_path_factory.mktemp("adapted") / "run"
    create_tiny(directory)
    return directory, api.adapt(directory, episodes=6, episodes_per_update=3, reward="dense")


def test_the_robot_starts_at_the_last_latent_of_the_task(
    adapted: tuple[Path, Adapted], tmp_path: Path
) -> None:
    run, done = adapted
    policy = api.export(run, tmp_path / "policy.npz", latents=done.latents, task=7)
    explorer, prior = Explorer.load(policy), Explorer.load(api.export(run, tmp_path / "prior.npz"))
    context = done.outcome.contexts
    np.testing.assert_array_equal(explorer.latent_mean, np.float64(context.mean[7, -1]))
    np.testing.assert_allclose(explorer.latent_std, np.exp(np.float64(context.log_std[7, -1])))
    assert abs(explorer.latent_mean).min() > 0
    assert prior.latent_mean.tolist() == [0.0, 0.0]
    # Two updates lie behind it, so that the step size is that of the third update.
    assert (explorer.update, prior.update) == (2, 0)
    assert explorer.exported.rule.scale(explorer.update) == 0.5
    assert explorer.exported.description["task"] == 7


def test_the_command_does_the_same(
    adapted: tuple[Path, Adapted], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, done = adapted
    words = ["--latents", str(done.latents), "--task", "7"]
    assert cli.run(["export", str(run), str(tmp_path / "policy.npz"), *words]) == 0
    *table, path = capsys.readouterr().out.splitlines()
    assert path == str(tmp_path / "policy.npz")
    assert [line.split()[:2] for line in table[2:4]] == [["observation", "0"], ["observation", "1"]]
    assert "  control 0            1 * action, limits -1 to 1" in table
    assert "  control period       0.1 s" in table
    assert "  episode              40 steps, 4 s" in table
    assert Explorer.load(tmp_path / "policy.npz").update == 2


def test_from_what_a_search_has_found_the_gradient_goes_on_as_from_the_prior(
    adapted: tuple[Path, Adapted], tmp_path: Path
) -> None:
    run, _ = adapted
    rule = BestOf()
    found = api.adapt(run, rule=rule, episodes=2, num_tasks=2, deploy_episodes=1)
    path = api.export(run, tmp_path / "policy.npz", latents=found.latents, task=1)
    explorer = Explorer.load(path)
    np.testing.assert_array_equal(explorer.latent_mean, found.outcome.contexts.mean[1, -1])
    assert explorer.latent_std.tolist() == [1.0, 1.0]
    assert explorer.update == 0  # the whole first step, and none that many updates have halved


def test_the_settings_of_the_rule_are_exported(
    adapted: tuple[Path, Adapted], tmp_path: Path
) -> None:
    run, _ = adapted
    rule = maesn.GradientRule(step_scale=0.5, full_steps=7, start_std=2.0)
    path = api.export(run, tmp_path / "changed.npz", rule=rule)
    changed = Explorer.load(path)
    usual = Explorer.load(api.export(run, tmp_path / "usual.npz"))
    old, new = usual.exported.rule, changed.exported.rule
    np.testing.assert_allclose(new.mean_step, 0.5 * old.mean_step)
    assert (old.full_steps, new.full_steps) == (2, 7)
    np.testing.assert_allclose(changed.latent_std, 2.0 * usual.latent_std)


def test_what_cannot_be_a_start_is_refused(adapted: tuple[Path, Adapted], tmp_path: Path) -> None:
    run, done = adapted
    path = tmp_path / "policy.npz"
    broken, goals, three = (tmp_path / f"{name}.npz" for name in ("broken", "goals", "three"))
    broken.write_bytes(b"PK\x03\x04 and no more")
    np.savez(goals, goal=np.zeros((3, 2)))
    np.savez(three, mean=np.zeros((2, 1, 3)), log_std=np.zeros((2, 1, 3)), first_update=0)
    for latents, task, named in (
        *((done.latents, None, "belong together"), (None, 0, "belong together")),
        *((done.latents, -1, "least 0"), (done.latents, 100, "most 99")),
        *((broken, 0, "broken"), (goals, 0, "other arrays"), (three, 0, "3 components")),
    ):
        with pytest.raises(RunError, match=named):
            api.export(run, path, latents=latents, task=task)
    assert not path.exists()


def test_latents_of_other_weights_are_refused(
    adapted: tuple[Path, Adapted], tmp_path: Path
) -> None:
    run, done = adapted
    other = Run.open(shutil.copytree(run, tmp_path / "run"))
    other.save_state(jax.tree.map(lambda x: x + 1, other.latest_state()))
    with pytest.raises(RunError, match="was adapted with other weights"):
        api.export(other, tmp_path / "policy.npz", latents=done.latents, task=0)
