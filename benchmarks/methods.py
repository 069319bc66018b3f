"""Time of every method, as a multiple of what its physics alone takes.

    python benchmarks/methods.py

Of the methods that are meta-trained, a meta-iteration (see `meta_iteration.py`); of those that
learn each task from scratch, an update of all tasks at once, with the episodes before it. Physics
means the same episodes, again, on the engine alone (see `bare_physics.py`). Both are timed in turn
in one process. Compilation is excluded; the first meta-iteration or update, with it, has columns of
its own, `cold` with an empty cache and `warm` with a full one. Last comes the most memory that the
process has taken.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from bare_physics import BarePhysics, Recorder
from meta_iteration import Settings as IterationSettings
from meta_iteration import Times, peak_memory
from meta_iteration import measure as measure_iterations

from maesn import rl2
from maesn.envs import AbstractMujocoEnv
from maesn.envs.sources import resolve_family
from maesn.learners import (
    PRESETS,
    SCRATCH,
    AbstractFastLearner,
    AbstractMetaLearner,
    recommended,
    recommended_run,
)
from maesn.policies import HyperRecurrent
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

# As if half of a run were over: of `maesn_theta`, all parts move by then.
SECOND_STAGE = 150
HYPERNETWORK = "rl2_hyper"


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    family: str = "wheeled"
    """A family that is moved by the MuJoCo engine; your own as `module:name`."""
    methods: tuple[str, ...] = (
        "maesn", "latent_space", "maml_bias_only", "maml", "maml_bias", "maesn_theta", "rl2",
        "rl2_trpo", HYPERNETWORK, "varibad", "pearl",
    )  # fmt: skip
    """Presets that are meta-trained, and `rl2_hyper`, RL2 with a hypernetwork. `pearl` has the
    settings and batches of `maesn train pearl`, the others those that follow."""
    scratch: tuple[str, ...] = ("reinforce", "trpo", "vime")
    """Methods that learn each task from scratch."""
    tasks: int = 20
    """Tasks of a meta-iteration, and of an update."""
    meta_episodes: int = 20
    """Episodes per task and collection in meta-training."""
    scratch_episodes: int = 50
    """Episodes per task and update from scratch."""
    repetitions: int = 9
    """Timed meta-iterations or updates; the median counts."""


def learner_of(method: str, settings: Settings) -> AbstractMetaLearner[Any, Any]:
    """Return what is meta-trained."""
    if method == "pearl":
        return recommended(method, settings.family)
    if method == HYPERNETWORK:
        return rl2(policy=HyperRecurrent(), meta_batch_size=settings.tasks)
    return PRESETS[method](meta_batch_size=settings.tasks)


def measure_updates(name: str, settings: Settings) -> Times:
    """Time updates from scratch and the bare engine in turn."""
    family = resolve_family(settings.family)
    env, tasks = family.make_env(reward_kind="sparse"), family.task_set("validation")
    assert isinstance(env, AbstractMujocoEnv), f"{settings.family} does not run on MuJoCo"
    world = make_world(env, tasks)
    collect = Recorder(Collector(world, settings.scratch_episodes))
    physics = BarePhysics(env, settings.tasks * settings.scratch_episodes)
    learner: AbstractFastLearner[Any] = SCRATCH[name](env.observation_size, env.action_size)
    state = learner.init(jax.random.split(jax.random.key(0), settings.tasks))
    whole, collecting, bare = [], [], []
    for update in range(1 + settings.repetitions):
        keys = jax.random.split(jax.random.key(1 + update), settings.tasks)
        collect.clear()
        begin = time.perf_counter()
        episodes = collect(keys, learner.agents(state), jnp.arange(settings.tasks))
        state = jax.block_until_ready(learner.update(state, episodes))
        whole.append(time.perf_counter() - begin)
        collecting.append(collect.seconds)
        bare.append(physics.timed(collect.played()))
    world.close()
    timed = (np.array(seconds[1:]) for seconds in (whole, collecting, bare))
    return Times(whole[0], *timed, collect.steps)


def measure(name: str, settings: Settings) -> Times:
    """Time one method in this process."""
    if name in settings.scratch:
        return measure_updates(name, settings)
    own = recommended_run(name, settings.family) if name == "pearl" else {}
    chosen = IterationSettings(
        family=settings.family,
        episodes_per_task=own.get("episodes_per_task", settings.meta_episodes),
        iterations=settings.repetitions,
        first_iteration=SECOND_STAGE,
    )
    return measure_iterations(chosen, learner_of(name, settings))


def print_row(name: str, settings: Settings) -> None:
    """Time one method in two processes, and print its line of the table.

    The first one finds nothing compiled, the second one finds everything.
    """
    with tempfile.TemporaryDirectory() as cache:
        cold = _in_process(name, replace(settings, repetitions=0), cache)
        found = _in_process(name, settings, cache)
    whole, collecting, bare = (np.median(found[one]) for one in ("whole", "collecting", "bare"))
    print(
        f"{name:15s} {whole:9.3f} {collecting:12.3f} {bare:9.3f} {found['ratio']:7.2f} "
        f"{cold['first']:7.1f} {found['first']:7.1f} {found['peak']:6.2f}",
        flush=True,
    )


def _in_process(name: str, settings: Settings, cache: str) -> dict[str, Any]:
    asked = json.dumps(asdict(settings))
    command = [sys.executable, __file__, "one", name, asked]
    compiled = {
        "JAX_COMPILATION_CACHE_DIR": cache,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    done = subprocess.run(
        command, env=os.environ | compiled, check=True, stdout=subprocess.PIPE, text=True
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def run_one(name: str, asked: str) -> None:
    """Time one method in this process, and print its numbers."""
    times = measure(name, Settings(**json.loads(asked)))
    lists = {one: getattr(times, one).tolist() for one in ("whole", "collecting", "bare")}
    ratio = times.ratio if len(times.whole) else math.nan
    print(json.dumps({**lists, "first": times.first, "ratio": ratio, "peak": peak_memory()}))


def main(settings: Settings) -> None:
    """Time all methods."""
    print(f"{settings.family}, {settings.tasks} tasks, median of {settings.repetitions}, seconds")
    print(
        f"{'':15s} {'whole':>9s} {'collections':>12s} {'physics':>9s} {'ratio':>7s} "
        f"{'cold':>7s} {'warm':>7s} {'GiB':>6s}"
    )
    print(f"a meta-iteration, {settings.meta_episodes} episodes per task and collection")
    for method in settings.methods:
        print_row(method, settings)
    print(f"an update of all tasks, {settings.scratch_episodes} episodes each")
    for method in settings.scratch:
        print_row(method, settings)


if __name__ == "__main__":
    if sys.argv[1:2] == ["one"]:
        run_one(*sys.argv[2:])
    else:
        main(tyro.cli(Settings))
