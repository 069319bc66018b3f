"""What two processes gain over one: in a meta-iteration that they share, and in a study.

    python benchmarks/scaling.py meta-iteration --family wheeled
    python benchmarks/scaling.py study

Every process has one thread, XLA's included. Compilation is excluded. From what two processes
measure follows a model of more hosts (`docs/howto/cluster.md` says what is in it).
"""

import dataclasses
import json
import math
import os
import socket
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
from jax.flatten_util import ravel_pytree

from maesn.envs.sources import resolve_family
from maesn.learners import PRESETS, GradientMetaLearner, Problem
from maesn.numerics.mesh import over_tasks, total
from maesn.numerics.processes import Sharing, wait_for_all
from maesn.studies.executors import thread_variables
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

HOSTS = (1, 2, 4, 5, 10, 20, 32, 64)
# Sums of a meta-iteration beside those of the curvature: gradient, candidates, what is logged.
OTHER_SUMS = 15
REPEATED_SUMS = 100


@dataclass(frozen=True)
class MetaIteration:
    """A meta-iteration by two processes, over one by one process."""

    family: str = "wheeled"
    """Family of tasks."""
    meta_batch_size: int = 20
    """Tasks per meta-iteration."""
    episodes_per_task: int = 50
    """Episodes per task and collection."""
    iterations: int = 9
    """Timed meta-iterations; the median counts."""
    latency: float = 30e-6
    """Of one message between two hosts of the model, in seconds."""
    bandwidth: float = 1.25e9
    """Between two hosts of the model, in bytes per second; 1.25e9 is 10 Gbit/s."""


@dataclass(frozen=True)
class Study:
    """A study of eight jobs by two workers, over one by one worker."""

    iterations: int = 30
    """Meta-iterations of each job; enough of them for a minute."""
    family: str = "wheeled"
    """Family of tasks."""


@dataclass(frozen=True)
class Times:
    """What one process has measured, in seconds."""

    whole: list[float]
    """Of each timed meta-iteration."""
    collecting: list[float]
    """Of its collections."""
    one_sum: float
    """Of one sum over the processes of as many numbers as there are parameters."""
    parameters: int
    """Numbers in such a sum."""
    cg_steps: int


class Timed:
    """A collector with a clock."""

    def __init__(self, collect: Collector) -> None:
        self._collect = collect
        self.num_tasks, self.episodes_per_task = collect.num_tasks, collect.episodes_per_task
        self.seconds = 0.0

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        jax.block_until_ready(arguments)
        begin = time.perf_counter()
        episodes = jax.block_until_ready(self._collect(*arguments, **named))
        self.seconds += time.perf_counter() - begin
        return episodes


def measure(settings: MetaIteration) -> Times:
    """Time meta-iterations in this process, which shares them if others were begun beside it."""
    family = resolve_family(settings.family)
    env = family.make_env(reward_kind="dense")
    world = make_world(env, family.task_set("training"), num_threads=1)
    collect = Timed(Collector(world, settings.episodes_per_task))
    learner = PRESETS["maesn"](meta_batch_size=settings.meta_batch_size)
    assert isinstance(learner, GradientMetaLearner)
    sizes = env.observation_size, env.action_size, collect.num_tasks
    state = learner.init(jax.random.key(0), Problem(*sizes))
    whole, collecting = [], []
    for iteration in range(settings.iterations + 1):
        wait_for_all(f"iteration {iteration}")
        collect.seconds, begin = 0.0, time.perf_counter()
        state, _ = jax.block_until_ready(
            learner.step(jax.random.key(1 + iteration), state, collect)
        )
        whole.append(time.perf_counter() - begin)
        collecting.append(collect.seconds)
    world.close()
    flat = ravel_pytree(state.parameters)[0]
    cg_steps = learner.outer.trust_region.cg_steps
    return Times(whole[1:], collecting[1:], _time_of_sum(flat), flat.size, cg_steps)


def _time_of_sum(flat: jax.Array) -> float:
    durations = []
    for _ in range(5):
        begin = time.perf_counter()
        jax.block_until_ready(over_tasks(_sums, flat, None))
        durations.append((time.perf_counter() - begin) / REPEATED_SUMS)
    return min(durations)


def _sums(flat: jax.Array, _: None) -> tuple[jax.Array, None]:
    # Each needs the one before, as in conjugate gradients.
    return jax.lax.fori_loop(0, REPEATED_SUMS, lambda _, x: total(x) * 0.5, flat), None


def in_processes(settings: MetaIteration, number: int) -> list[Times]:
    """Measure in so many processes of one thread that share the meta-iterations."""
    with socket.socket() as found:
        found.bind(("localhost", 0))
        port = found.getsockname()[1]
    environment = os.environ | thread_variables(1)
    asked = json.dumps(dataclasses.asdict(settings))
    processes = [
        subprocess.Popen(
            [sys.executable, __file__, "process", asked, str(port), str(number), str(process)],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        for process in range(number)
    ]
    outputs = [process.communicate()[0] for process in processes]
    assert not any(process.returncode for process in processes), "a process has failed"
    return [Times(**json.loads(output.splitlines()[-1])) for output in outputs]


def run_process(asked: str, port: str, number: str, process: str) -> None:
    """Measure in this process, and print it."""
    several = Sharing(1, f"localhost:{port}", int(number), int(process))
    with (several if int(number) > 1 else Sharing()).begun():
        found = measure(MetaIteration(**json.loads(asked)))
    print(json.dumps(dataclasses.asdict(found)), flush=True)


def report(settings: MetaIteration, one: Times, two: list[Times]) -> None:
    """Print the gain, where the rest goes, and the model."""
    alone = float(np.median(one.whole))
    whole = float(np.median([times.whole for times in two]))
    collecting = np.array([times.collecting for times in two])
    waiting = float(np.median(collecting.max(0) - collecting.mean(0)))
    sums = (one.cg_steps + 1 + OTHER_SUMS) * two[0].one_sum
    excess = whole - alone / 2
    serial = max(excess - waiting - sums, 0.0)
    print(
        f"maesn on {settings.family}, {settings.meta_batch_size} tasks x "
        f"{settings.episodes_per_task} episodes, processes of one thread, median of "
        f"{settings.iterations}"
    )
    rows = {
        "meta-iteration, one process": alone,
        "meta-iteration, two processes": whole,
        "  half of the one": alone / 2,
        "  waiting for the slower collection": waiting,
        "  sums over processes": sums,
        "  what both do (the rest)": excess - waiting - sums,
        "collections, one process": float(np.median(one.collecting)),
        "collections, two processes": float(np.median(collecting)),
    }
    for name, seconds in rows.items():
        print(f"{name:40s} {seconds:8.3f} s")
    print(f"speed-up: {alone / whole:.2f}")
    _print_model(settings, one, alone, 2 * serial, waiting)


def _print_model(
    settings: MetaIteration, one: Times, alone: float, serial: float, waiting: float
) -> None:
    """Print what more hosts would gain, if a host is one process.

    A task takes equally long everywhere. `serial` is what does not shrink. A sum is a ring: each
    host sends the parameters nearly twice, in 2 (hosts - 1) messages.
    """
    sums, size = one.cg_steps + 1 + OTHER_SUMS, 4 * one.parameters
    serial = min(serial, alone)
    per_task = (alone - serial) / settings.meta_batch_size
    print(
        f"\nmodel: {per_task:.4f} s per task, {serial:.3f} s serial, {waiting:.3f} s waiting, "
        f"{sums} sums of {size:,} bytes, {settings.latency * 1e6:.0f} us and "
        f"{settings.bandwidth:.2g} bytes/s between hosts"
    )
    print("hosts, then tasks per host, sums, whole, speed-up, efficiency; at the right of 64 tasks")
    for hosts in HOSTS:
        columns = []
        for tasks in (settings.meta_batch_size, 64):
            own = math.ceil(tasks / hosts)
            message = settings.latency + size / hosts / settings.bandwidth
            talking = sums * 2 * (hosts - 1) * message
            whole = own * per_task + serial + talking + (waiting if hosts > 1 else 0.0)
            gain = (tasks * per_task + serial) / whole
            columns.append(
                f"{own:4d} {talking:9.4f} s {whole:7.3f} s {gain:6.2f} {gain / hosts:6.0%}"
                if tasks % hosts == 0
                else f"{'-':>4s} {'':40s}"
            )
        print(f"{hosts:5d}  {'   |   '.join(columns)}")


def time_study(settings: Study) -> None:
    """Print how long a study of eight jobs takes one worker and two."""
    text = (
        f'family = "{settings.family}"\n[runs.maesn]\nseeds = [0, 1, 2, 3, 4, 5, 6, 7]\n'
        f"iterations = {settings.iterations}\n"
    )
    seconds = {}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "eight.toml"
        environment = os.environ | {"MAESN_CACHE": str(Path(folder) / "cache")}
        # The first one fills the compilation cache.
        for name, iterations, workers in (("warm", 1, 1), ("one", 0, 1), ("two", 0, 2)):
            changed = text if not iterations else text.replace(f"= {settings.iterations}", "= 1")
            file.write_text(changed)
            begin = time.perf_counter()
            options = ["--out", str(Path(folder) / name), "--workers", str(workers)]
            command = [sys.executable, "-m", "maesn", "study", "run", str(file), *options]
            subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
            seconds[name] = time.perf_counter() - begin
    print(f"eight jobs of {settings.iterations} meta-iterations on {settings.family}")
    print(f"one worker {seconds['one']:.1f} s, two workers {seconds['two']:.1f} s")
    print(f"speed-up: {seconds['one'] / seconds['two']:.2f}")


def main(settings: MetaIteration | Study) -> None:
    """Run one of the two benchmarks."""
    if isinstance(settings, Study):
        time_study(settings)
    else:
        report(settings, *in_processes(settings, 1), in_processes(settings, 2))


if __name__ == "__main__":
    if sys.argv[1:2] == ["process"]:
        run_process(*sys.argv[2:])
    else:
        main(tyro.cli(MetaIteration | Study))
