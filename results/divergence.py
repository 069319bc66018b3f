"""Print how far the latents of the training tasks have moved from the prior, as a table.

python results/divergence.py results/jobs/train-wheeled-maesn*
"""

from pathlib import Path

import numpy as np
import tyro

from maesn.context import Latent, LatentContext
from maesn.learners.gradient.fast_learner import GradientFastLearner
from maesn.numerics import DiagonalGaussian
from maesn.runs.run import Run
from maesn.studies.members import RUN


def print_divergence(jobs: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """Print a row for each run with a latent and a checkpoint."""
    print("| method | step sizes | KL weight | seed | KL to the prior, nats |")
    print("|---|---|---:|---:|---:|")
    rows = []
    for run in (Run.open(job / RUN) for job in jobs):
        context = getattr(run.learner, "context", None)
        if isinstance(context, LatentContext) and run.checkpoints():
            steps = "learned" if run.learner.adaptation.context.learned else "fixed"
            chosen = f"{run.settings.method} | {steps} | {context.kl_weight:g}"
            rows.append(f"| {chosen} | {run.settings.seed} | {mean_divergence(run):.2f} |")
    print(*sorted(rows), sep="\n")
    print("\nMean over the training tasks of KL(q(z) || N(0, I)) in the last checkpoint.")


def mean_divergence(run: Run) -> float:
    """Return the mean divergence of the training tasks' latents from N(0, I)."""
    learner = run.learner.fast_learner(run.latest_state())
    assert isinstance(learner, GradientFastLearner)
    latents = learner.context_table
    assert isinstance(latents, Latent)
    prior = DiagonalGaussian.standard(latents.mean.shape)
    return float(np.mean(latents.distribution.kl(prior)))


if __name__ == "__main__":
    tyro.cli(print_divergence)
