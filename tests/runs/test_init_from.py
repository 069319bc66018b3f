"""A new run that begins with what another one has learned."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from small_runs import create, goals, reopened, tiny_maesn, tiny_settings

from maesn.context import BiasContext, LatentContext
from maesn.policies import GaussianMLP
from maesn.reporting.sources import read_series
from maesn.runs.run import Run
from maesn.storage import RunError


def save_changed(run: Run, change: float) -> Any:
    """Pretend that a run has learned something."""
    state = jax.tree.map(lambda x: x + jax.numpy.asarray(change, x.dtype), run.latest_state())
    run.save_state(state, 10)
    return state


@pytest.mark.parametrize("context", [LatentContext(), BiasContext(size=2)])
def test_a_run_begins_with_what_another_has_learned(tmp_path: Path, context: Any) -> None:
    learner = tiny_maesn(context=context)
    learned = save_changed(create(tmp_path / "source", learner), 1.0)
    np.savez(tmp_path / "mine.npz", goal=goals(7))
    settings = tiny_settings(tasks=str(tmp_path / "mine.npz"), seed=9)
    run = Run.create(tmp_path / "run", learner, settings, init_from=tmp_path / "source")
    fresh, begun = run.untrained_state(), reopened(run).latest()
    assert begun.iteration == begun.environment_steps == int(begun.state.iteration) == 0
    kept = [begun.state.parameters.policy, begun.state.parameters.step_sizes]
    wanted = [learned.parameters.policy, learned.parameters.step_sizes]
    # Latents belong to their tasks; the bias belongs to all of them.
    is_latent = isinstance(context, LatentContext)
    kept.append(begun.state.parameters.context_table)
    wanted.append(fresh.parameters.context_table if is_latent else learned.parameters.context_table)
    jax.tree.map(np.testing.assert_array_equal, kept, wanted)
    if is_latent:
        assert begun.state.parameters.context_table.mean.shape == (7, 2)


def test_a_run_that_began_with_another_is_no_seed_of_one_that_did_not(tmp_path: Path) -> None:
    source = create(tmp_path / "source", tiny_maesn())
    create(tmp_path / "fresh", tiny_maesn(), seed=1)
    Run.create(tmp_path / "begun", tiny_maesn(), tiny_settings(seed=2), init_from=source.directory)
    series = read_series([tmp_path / name for name in ("source", "fresh", "begun")])
    assert [[run.path.name for run in one.runs] for one in series] == [
        ["source", "fresh"],
        ["begun"],
    ]


@pytest.mark.parametrize(
    ("learner", "family", "tensor"),
    [
        (tiny_maesn(policy=GaussianMLP((9,))), "point", "policy/mlp/layers/0/bias"),
        (tiny_maesn(context=BiasContext(2)), "point", "step_sizes/context"),
        (tiny_maesn(), "wheeled", "layers/0/weight"),
    ],
)
def test_a_source_that_does_not_fit_is_refused(
    tmp_path: Path, learner: Any, family: str, tensor: str
) -> None:
    create(tmp_path / "source", learner, family=family)
    with pytest.raises(RunError, match=tensor):
        Run.create(tmp_path / "run", tiny_maesn(), tiny_settings(), init_from=tmp_path / "source")
    assert not (tmp_path / "run").exists()
