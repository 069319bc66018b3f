"""A new run that begins with what another one has learned."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from small_runs import create, finish, goals, reopened, tensors, tiny_maesn

from maesn.context import BiasContext, LatentContext
from maesn.policies import GaussianMLP
from maesn.runs.run import Run
from maesn.runs.storage import RunError
from maesn.runs.training import init_from


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
    run = create(tmp_path / "run", learner, tasks=str(tmp_path / "mine.npz"), seed=9)
    fresh = run.latest_state()
    init_from(run, tmp_path / "source")
    begun = reopened(run).latest()
    assert begun.iteration == begun.environment_steps == int(begun.state.iteration) == 0
    kept = [begun.state.parameters.policy, begun.state.parameters.step_sizes]
    wanted = [learned.parameters.policy, learned.parameters.step_sizes]
    # Latents belong to their tasks; the bias belongs to all of them.
    is_latent = isinstance(context, LatentContext)
    kept.append(begun.state.parameters.context)
    wanted.append(fresh.parameters.context if is_latent else learned.parameters.context)
    jax.tree.map(np.testing.assert_array_equal, kept, wanted)
    if is_latent:
        assert begun.state.parameters.context.mean.shape == (7, 2)


@pytest.mark.parametrize(
    ("learner", "settings", "said"),
    [
        (tiny_maesn(policy=GaussianMLP((9,))), {}, r"tensor `.*policy/mlp/layers/0/bias` should"),
        (
            tiny_maesn(context=BiasContext(2)),
            {},
            "tensor `parameters/context/value` should be absent",
        ),
        (tiny_maesn(context=LatentContext(size=3)), {}, "tensor `parameters/policy/mlp/"),
        (tiny_maesn(), {"family": "wheeled"}, "`observation_size` 2 as `.*run` has, got 12"),
    ],
)
def test_a_source_that_does_not_fit_is_refused(
    tmp_path: Path, learner: Any, settings: dict[str, Any], said: str
) -> None:
    create(tmp_path / "source", learner, **settings)
    run = create(tmp_path / "run", tiny_maesn())
    before = tensors(run.checkpoints()[0])
    with pytest.raises(RunError, match=said):
        init_from(run, tmp_path / "source")
    assert tensors(run.checkpoints()[0]) == before


def test_a_trained_run_cannot_begin_again(tmp_path: Path) -> None:
    run = finish(create(tmp_path / "run"), iterations=3)
    with pytest.raises(RunError, match=r"must be a new run .* has done 3 iterations"):
        init_from(run, create(tmp_path / "source").directory)
