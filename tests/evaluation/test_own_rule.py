"""The guide to a rule of one's own, taken at its word: its file, its commands."""

import math
from pathlib import Path
from types import ModuleType, SimpleNamespace

import jax
import numpy as np
import pytest
from guides import Guide
from small_runs import tiny_maesn, tiny_settings

import maesn
from maesn.runs.run import Run

GUIDE = Guide("own_rule.md", "my_rules")


@pytest.fixture
def rules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return GUIDE.imported(tmp_path, monkeypatch)


def test_the_next_latents_are_drawn_around_the_best(rules: ModuleType, tmp_path: Path) -> None:
    run = Run.create(tmp_path / "run", tiny_maesn(), tiny_settings())
    trained = maesn.Trained(run.learner, run.latest_state())
    learner = rules.CrossEntropy(elite=0.5).fast_learner(trained, run.env())
    state = learner.init(jax.random.split(jax.random.key(0), 2))
    np.testing.assert_allclose(state.context.log_std, math.log(2.0), rtol=1e-6)
    generator = np.random.default_rng(0)
    returns, z = generator.normal(size=(2, 6)), generator.normal(size=(2, 6, 2))
    played = SimpleNamespace(undiscounted_return=np.float32(returns), z=np.float32(z))
    latent = learner.update(state, played).context
    for task in range(2):
        best = sorted(range(6), key=lambda episode: -returns[task, episode])[:3]
        np.testing.assert_allclose(latent.mean[task], z[task, best].mean(0), rtol=1e-5)
        spread = z[task, best].std(0) + 0.05
        np.testing.assert_allclose(np.exp(latent.log_std[task]), spread, rtol=1e-5)
    deployed = learner.agents(state, "deploy").context
    np.testing.assert_array_equal(deployed.mean, state.context.mean)
    assert float(np.exp(deployed.log_std).max()) < 1e-5


@pytest.mark.long
@pytest.mark.usefixtures("rules")
def test_its_commands_do_what_they_say() -> None:
    GUIDE.follow("adapt", "compare", more=["--num-tasks", "2"])
    written = Path("maesn-wheeled/adaptation").glob("test-*-sparse-crossentropy-*.csv")
    assert len(list(written)) == 2  # with other settings of the rule the table is another one
    assert list(Path("cross-entropy").rglob("comparison*.png"))
    (summary,) = Path("cross-entropy").rglob("summary.md")
    assert "MAESN (CrossEntropy)" in summary.read_text("utf-8")
