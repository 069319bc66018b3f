r"""Seconds of an outer step of MAML with TRPO, beside two other libraries on the same episodes.

    git clone https://github.com/tristandeleu/pytorch-maml-rl
    git clone https://github.com/rainx0r/metaworld-algorithms
    python benchmarks/outer_step_peers.py --torch pytorch-maml-rl --jax metaworld-algorithms \
        --torch-python TORCH/bin/python --jax-python JAX/bin/python

TORCH and JAX are environments with what each library needs: torch, numpy and gym for the first, for
the second what its `pyproject.toml` names (Python 3.12 or newer). All do the same work on the same
episodes: the gradient through one inner update, ten conjugate gradient steps with the curvature of
all time steps, and one candidate of the line search. The values differ: each starts from random
weights of its own. No episode is played, and nothing is compiled in the timed part. Ours also
estimates advantages and adapts the agents once more. The last row has our defaults: 20 conjugate
gradient steps, the curvature of every 20th time step, the Hessian of every 4th, and up to 15
candidates. The rows run in turn, each with all cores.
"""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro
from outer_step_theirs import CG_STEPS

from maesn import GradientMetaLearner
from maesn.envs import find_family
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import Problem
from maesn.learners.gradient.outer import TrustRegionOuterStep
from maesn.learners.presets import maml
from maesn.numerics.devices import request_devices, sharing
from maesn.numerics.trust_region import TrustRegion
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

HERE = Path(__file__).parent
EQUAL = TrustRegionOuterStep(TrustRegion(cg_steps=CG_STEPS, max_backtracks=1), 1, 1)


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    torch: Path | None = None
    """A clone of pytorch-maml-rl; None leaves it out."""
    jax: Path | None = None
    """A clone of metaworld-algorithms; None leaves it out."""
    torch_python: Path = Path(sys.executable)
    """The interpreter that runs pytorch-maml-rl."""
    jax_python: Path = Path(sys.executable)
    """The interpreter that runs metaworld-algorithms."""
    family: str = "wheeled"
    """Family whose episodes are learned from."""
    tasks: int = 20
    """Tasks of a meta-batch."""
    episodes: int = 20
    """Episodes per task, before the inner update and after it."""
    repetitions: int = 5
    """Timed steps; the median counts."""


class Replay:
    """Passes calls on to a collector once, and answers with the same episodes ever after."""

    def __init__(self, collect: Collector) -> None:
        self._collect = collect
        self.num_tasks, self.episodes_per_task = collect.num_tasks, collect.episodes_per_task
        self.kept: dict[int, Episodes] = {}

    def __call__(self, keys: Any, agents: Agents, task_index: Any, stage: int = 0) -> Episodes:
        """See `Collector`."""
        if stage not in self.kept:
            self.kept[stage] = jax.block_until_ready(self._collect(keys, agents, task_index))
        return self.kept[stage]


def our_seconds(learner: GradientMetaLearner, settings: Settings, kept: Path | None) -> float:
    """Return the seconds of a step of ours; write the episodes to `kept`."""
    family = find_family(settings.family)
    request_devices(None)
    with sharing(None, learner.tasks_for_cores):
        world = make_world(family.make_env(), family.task_set("training"))
        replay = Replay(Collector(world, settings.episodes))
        sizes = world.env.observation_size, world.env.action_size, replay.num_tasks
        state = learner.init(jax.random.key(0), Problem(*sizes))
        seconds = []
        for _ in range(1 + settings.repetitions):
            begin = time.perf_counter()
            jax.block_until_ready(learner.step(jax.random.key(1), state, replay))
            seconds.append(time.perf_counter() - begin)
        world.close()
    if kept is not None:
        write(learner, replay.kept, kept)
    return float(np.median(seconds[1:]))


def write(learner: GradientMetaLearner, episodes: dict[int, Episodes], path: Path) -> None:
    """Write what an outer step needs of both batches, `[task, episode, time, ...]` each."""
    arrays = {}
    for stage, batch in episodes.items():
        arrays |= {
            f"observation{stage}": batch.observation[..., :-1, :],
            f"action{stage}": batch.action,
            f"reward{stage}": batch.reward,
            f"advantage{stage}": learner.advantage.of_tasks(batch).step,
            f"log_prob{stage}": batch.behaviour.log_prob(batch.action),
            f"mean{stage}": batch.behaviour.mean,
            f"std{stage}": np.exp(batch.behaviour.log_std),
        }
    np.savez(path, **{name: np.asarray(value, np.float32) for name, value in arrays.items()})


def print_theirs(library: str, episodes: Path, settings: Settings) -> None:
    """Time another library in its own interpreter, unless there is no clone of it."""
    clone, python = getattr(settings, library), getattr(settings, f"{library}_python")
    if clone is not None:
        script = HERE / f"outer_step_{library}.py"
        command = [python, script, episodes, str(settings.repetitions)]
        environment = os.environ | {"PYTHONPATH": str(clone.resolve())}
        subprocess.run(command, check=True, env=environment)


def main(settings: Settings) -> None:
    """Time ours, then theirs, then ours with its own defaults."""
    print(
        f"outer step of MAML-TRPO, {settings.family}, {settings.tasks} tasks x "
        f"{settings.episodes} episodes, two layers of 100 tanh, median of {settings.repetitions}"
    )
    with tempfile.TemporaryDirectory() as folder:
        episodes = Path(folder, "episodes.npz")
        equal = maml(meta_batch_size=settings.tasks, outer=EQUAL)
        ours = our_seconds(equal, settings, episodes)
        print(f"{ours:8.2f} s  maesn", flush=True)
        for library in ("torch", "jax"):
            print_theirs(library, episodes, settings)
    default = our_seconds(maml(meta_batch_size=settings.tasks), settings, None)
    print(f"{default:8.2f} s  maesn, its own defaults")


if __name__ == "__main__":
    main(tyro.cli(Settings))
