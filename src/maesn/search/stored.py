"""The prior over returns of a run, made once and kept beside its checkpoints."""

import json
import logging
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.progress import Progress as ProgressBar

from maesn.envs import AnyEnv, RewardKind, TaskSet, describe_env
from maesn.runs.checkpoint import digest_of_arrays, read_checkpoint, save_checkpoint
from maesn.runs.run import Run
from maesn.runs.sources import working_copy
from maesn.runtime.archive import parse_json
from maesn.runtime.record import decoded, encoded
from maesn.runtime.return_model import NOMINAL, ReturnPrior
from maesn.search.calibration import calibrated
from maesn.search.learner import latent_of
from maesn.search.prior import USUAL, PriorSettings, Progress, adapted_latents, make_prior
from maesn.storage import RunError, refusals
from maesn.worlds.collector import Collector

logger = logging.getLogger(__name__)

PRIORS = "priors"
_SEARCHES = np.uint32(2**32 - 3)  # folded into the key of the searches that calibrate
_EPISODES_TO_ADAPT = 20  # of each training task, for the one dense update; as in training


def prior_file(run: Run, env: AnyEnv, action_noise: bool = False) -> Path:
    """Return where a run's prior for an environment's reward is, or will be if there is none.

    A policy that comes with the library is never written to: a missing prior goes into its copy.
    """
    path = run.directory / PRIORS / _file_name(env, action_noise)
    return path if path.exists() else working_copy(run.directory) / PRIORS / path.name


def _file_name(env: AnyEnv, action_noise: bool) -> str:
    noisy = "-noisy" if action_noise else ""
    return f"{env.reward_kind}-{env.sparse_radius:g}{noisy}.safetensors"


def run_prior(
    run: Run,
    settings: PriorSettings = USUAL,
    *,
    reward: RewardKind = "sparse",
    sparse_radius: float | None = None,
    progress: Progress = lambda played, of: None,
    state: Any = None,
    directory: Path | None = None,
) -> tuple[Path, ReturnPrior]:
    """Make the prior over returns of a run, save it, and return both.

    Args:
        run: a run of a method with a latent.
        settings: how to make the prior.
        reward: reward of the new tasks.
        sparse_radius: sparse radius of the new tasks, in metres; None for the run's own.
        progress: called as `make_prior` says.
        state: one of the run's; None: the latest.
        directory: of the run that gets the file; None for the run itself, or a copy of a policy
            that comes with the library.

    Raises:
        RunError: the run has no latent, or something cannot be written.
        EpisodeError: an episode went wrong.
    """
    state = run.latest_state() if state is None else state
    with refusals(f"`{run.settings.method}` cannot search: "):
        latent = latent_of(run.learner.fast_learner(state))
        if len(run.training_tasks) < 2:
            raise ValueError("it was trained on one task, and a search needs several to compare.")
    spread = latent.spread if settings.spread is None else settings.spread
    draws, _ = settings.counts(run.env(), run.training_tasks)
    drawn = np.random.default_rng(settings.seed).standard_normal((draws, latent.size))
    latents = [spread * drawn]
    if settings.adapted:
        with closing(run.world(reward_kind="dense")) as dense:
            collect = Collector(dense, _EPISODES_TO_ADAPT)
            latents.append(adapted_latents(latent, collect, jax.random.key(settings.seed)))
    # In the precision of the file, so that making and reading a prior give the same numbers.
    archive = np.concatenate(latents).astype(np.float32)
    with closing(run.world(reward_kind=reward, sparse_radius=sparse_radius)) as world:
        prior = make_prior(latent, world, archive, settings, progress)
    if settings.searches and not settings.action_noise:
        unknown = TaskSet(run.task_set("validation")[: settings.searches])
        with closing(run.world(unknown, reward, sparse_radius=sparse_radius)) as unseen:
            key = jax.random.fold_in(jax.random.key(settings.seed), _SEARCHES)
            prior = calibrated(prior, latent, unseen, key)
    held, numbers = encoded(prior)
    arrays = {name: array.astype(np.float32) for name, array in held.items()}
    bound = bound_to(run, state, world.env, settings.action_noise)
    home = directory or working_copy(run.directory)
    path = home / PRIORS / _file_name(world.env, settings.action_noise)
    save_checkpoint(path, arrays, bound | {"numbers": json.dumps(numbers)})
    return path, read_prior(path)[0]


def find_prior(
    run: Run,
    state: Any,
    env: AnyEnv,
    action_noise: bool,
    name: str = "",
    any_reward: bool = False,
) -> ReturnPrior:
    """Return the prior of a run, in that state, for an environment. Make it if it is missing.

    Args:
        run: the run that the prior belongs to.
        state: one of the run's, which searches.
        env: of the new tasks; only its reward matters.
        action_noise: whether the archive was played with the noise of training.
        name: path of a prior; empty for the run's own.
        any_reward: whether a prior that was made for another reward will do.

    Raises:
        RunError: it belongs to other weights, training tasks, reward or noise, or is damaged.
    """
    path = Path(name) if name else prior_file(run, env, action_noise)
    if not name and not path.exists():
        settings = PriorSettings(action_noise=action_noise)
        logger.warning(
            "`%s` is missing. It is made now, once. For a rougher one, in a fraction of the time, "
            "stop this, and type: %s --draws 100 --episodes 1 --adapted False --searches 0",
            path,
            _command(run, env, action_noise),
        )
        with played_live() as progress:
            radius = env.sparse_radius or None
            asked = {"reward": env.reward_kind, "sparse_radius": radius, "state": state}
            _, prior = run_prior(run, settings, progress=progress, **asked)
        return prior
    prior, metadata = read_prior(path)
    for what, wanted in bound_to(run, state, env, action_noise).items():
        if metadata.get(what) != wanted and not (any_reward and what == "reward"):
            allow = ", or allow it by `any_reward=true`" if what == "reward" else ""
            again = f"make it again by `{_command(run, env, action_noise)}`"
            remedy = "leave out `prior`, for the run's own" if name else again
            raise RunError(
                f"`{path}` was made for another {what} than `{run.directory}` has here: "
                f"{remedy}{allow}."
            )
    return prior


def _command(run: Run, env: AnyEnv, action_noise: bool) -> str:
    command = f"maesn prior {run.typed}"
    if action_noise:
        command += " --action-noise True"
    if env.reward_kind != "sparse":
        command += f" --reward {env.reward_kind}"
    if env.sparse_radius != run.env().sparse_radius:
        command += f" --sparse-radius {env.sparse_radius:g}"
    return command


@contextmanager
def played_live() -> Iterator[Progress]:
    """Show on a terminal how much of an archive has been played, and the time left."""
    console = Console(stderr=True)
    with ProgressBar(console=console, transient=True, disable=not console.is_terminal) as bar:
        shown = bar.add_task("latents played", total=None)
        yield lambda played, of: bar.update(shown, completed=played, total=of)


def bound_to(run: Run, state: Any, env: AnyEnv, action_noise: bool) -> dict[str, str]:
    """Return what a prior belongs to: digests of weights, training tasks and reward, and noise."""
    return {
        "checkpoint": digest_of_arrays(run.learner.weights(state)),
        "training task set": run.config.task_digest,
        "reward": json.dumps(describe_env(env), sort_keys=True),
        "action noise": str(action_noise),
    }


def read_prior(path: Path) -> tuple[ReturnPrior, dict[str, str]]:
    """Read a prior and its metadata, see `bound_to`; raises `RunError` if it is damaged."""
    values, metadata = read_checkpoint(path)
    try:
        # Older priors state no levels.
        levels = {"proposed_levels": [*NOMINAL], "deployed_levels": [*NOMINAL]}
        numbers = {**levels, **parse_json(metadata["numbers"])}
        return decoded(ReturnPrior, values, numbers), metadata
    except (KeyError, TypeError, ValueError) as error:
        raise RunError(f"`{path}` is no prior that `maesn prior` wrote ({error}).") from error
