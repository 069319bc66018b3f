"""Foreign environments that fail: the failure is named, and no process is left behind."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import strange_families
from playing import agents, keys, play
from strange_families import EPISODES, SEED, broken, family_of, impatient, is_running, seeds
from strangers import (
    HORIZON,
    Diarist,
    Walker,
    make_broken,
    make_hopeless,
    make_settable,
    make_stuck,
)

from maesn import cli
from maesn.envs import TaskSet
from maesn.foreign import pack_task
from maesn.foreign.worker import HostedEnvironment, HostedError
from maesn.worlds import EnvContractError, EpisodeError, check_env_contract, make_world
from maesn.worlds.collector import Collector

FAILURES = {
    10: "the observation is not finite: component 2 is nan",
    11: "the reward is not finite: nan",
    21: "`step` must return (observation, reward, terminated, truncated, info)",
    22: "`terminated` must be a truth value, got array([ True, False])",
    24: '`info["success"]` must be a truth value, got array([ True, False])',
    26: "`info` must be a dictionary, got None",
    30: "`step` raised ValueError: the gears are stuck",
    31: "`step` raised ValueError: <unlocked _thread.lock",
    34: "the environment has ended its process",
    40: "has not returned within `time_limit`, 2 s",
    41: "the environment has ended its process (exit code 3)",
    42: "the environment has ended its process",
}
AT_RESET = {
    50: "`set_task` raised KeyError: 'no such task'",
    51: "`info` must be a dictionary, got None",
    60: "the action space must be that of the family's first task in every task",
    62: "the observation space must be that of the family's first task in every task",
    63: "the environment raised RuntimeError: no actions today",
}
REASONS = FAILURES | AT_RESET
# One of each way in which a failure reaches the process that learns: a number or an exception that
# a worker reports, at a step or a reset, and workers that hang or are gone.
THROUGH_PROCESSES = (10, 11, 30, 31, 34, 40, 41, 42, 50, 63)
STEP = 2


def rows() -> np.ndarray:
    """Two tasks in which nothing happens, and one for each failure."""
    failing = [[0, 0, kind, STEP] for kind in REASONS]
    return np.float32([[0, 0, 0, 0], [1, 1, 0, 0], *failing])


@pytest.fixture(scope="module")
def collect() -> Iterator[Collector]:
    world = make_world(broken.make_env(), TaskSet(rows()), num_threads=2)
    yield Collector(world, EPISODES)
    world.close()


@pytest.fixture(scope="module")
def impatiently() -> Iterator[Collector]:
    world = make_world(impatient.make_env(), TaskSet(rows()), num_threads=2)
    yield Collector(world, EPISODES)
    world.close()


def play_tasks(collect: Collector, *task: int) -> list[int]:
    """Play, and return the processes that are at it."""
    collect(keys(2, SEED), agents(collect.world.env, 2), jnp.array(task))
    return processes_of(collect)


def processes_of(collect: Collector) -> list[int]:
    pool = collect.world.stepper._pool
    return pool.process_ids if pool else []


def unlucky_episodes(task: np.ndarray) -> set[int]:
    """The episodes of slot 1 in which something goes wrong."""
    starts = [Walker(task).reset(seed=int(seed))[0] for seed in seeds(2)[1]]
    return {episode for episode, place in enumerate(starts) if place[1] > 0}


@pytest.mark.parametrize("kind", [kind for kind in REASONS if kind not in THROUGH_PROCESSES])
def test_what_an_environment_must_not_do_is_named(kind: int) -> None:
    quiet, failing = (pack_task(row) for row in rows()[[0, 2 + list(REASONS).index(kind)]])
    hosted = HostedEnvironment(make_broken, "dense", None)
    hosted.facts(quiet)
    unlucky = next(s for s in range(99) if Walker(rows()[0]).reset(seed=s)[0][1] > 0)
    returned: list[np.ndarray] = []
    with pytest.raises(HostedError) as error:
        play_hosted(hosted, failing, unlucky, returned)
    assert REASONS[kind] in str(error.value)
    assert len(returned) == (0 if kind in AT_RESET else STEP)


def play_hosted(hosted: HostedEnvironment, task: bytes, seed: int, into: list[np.ndarray]) -> None:
    into.append(hosted.begin(task, seed))
    into.extend(hosted.step(np.zeros(2, np.float32)) for _ in range(HORIZON))


@pytest.mark.parametrize("kind", THROUGH_PROCESSES)
def test_what_goes_wrong_is_named_and_leaves_no_process_behind(
    kind: int, collect: Collector, impatiently: Collector
) -> None:
    collect = impatiently if kind == 40 else collect
    processes = play_tasks(collect, 0, 1)
    assert len(processes) == 2
    assert all(map(is_running, processes))
    task = 2 + list(REASONS).index(kind)
    with pytest.raises(EpisodeError) as error:
        play_tasks(collect, 0, task)
    assert REASONS[kind] in str(error.value)
    named = re.match(rf"stranger, task {task}, episode (\d), step (\d): ", str(error.value))
    assert named is not None
    if kind in AT_RESET:
        assert named[2] == "0"
    else:
        unlucky = unlucky_episodes(rows()[task])
        assert len(unlucky) == 1
        assert int(named[1]) in unlucky
        # What is wrong in the state of step 2, the call of step 1 has returned.
        assert int(named[2]) == STEP - (kind < 30)
    assert not any(map(is_running, processes))
    assert not processes_of(collect)


def test_ctrl_c_ends_all_processes_and_is_passed_on(collect: Collector) -> None:
    processes = play_tasks(collect, 0, 1)
    hanging = 2 + list(REASONS).index(40)
    timer = threading.Timer(2.0, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        play_tasks(collect, 0, hanging)
    assert not any(map(is_running, processes))
    assert not processes_of(collect)


def test_a_signal_to_all_processes_of_a_job_is_the_parents_to_handle(collect: Collector) -> None:
    processes = play_tasks(collect, 0, 1)
    for process in processes:
        for number in (signal.SIGTERM, signal.SIGHUP):
            os.kill(process, number)
    assert play_tasks(collect, 0, 1) == processes


ORPHANS = """
import os, sys, time
from functools import partial
from pathlib import Path
from strangers import make_parent
from maesn.foreign import WorkerPool, pack_task
make_env = partial(make_parent, sys.argv[1], Path(sys.argv[2]))
pool = WorkerPool(make_env, "dense", None, 1, 3600.0)
pool.describe(pack_task(None))
if sys.argv[1] == "is idle while its parent is being killed":
    os.closerange(3, 256)  # what is done to a process before its children can tell
time.sleep(3600)
"""


@pytest.mark.parametrize("how", ["hangs", "is idle", "is idle while its parent is being killed"])
def test_no_environment_outlives_a_parent_that_is_killed(how: str, tmp_path: Path) -> None:
    diary = tmp_path / "diary"
    parent = subprocess.Popen(
        [sys.executable, "-c", ORPHANS, how, str(diary)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    try:
        wait_until(lambda: diary.exists() and diary.read_text().count("\n") == 1, 120.0)
        processes = list(map(int, diary.read_text().split()))
        assert len(processes) == 2
        if how != "is idle while its parent is being killed":
            assert all(map(is_running, processes))
            parent.kill()
        wait_until(lambda: not any(map(is_running, processes)), 30.0)
    finally:
        parent.kill()
        parent.wait()


def wait_until(is_so: Callable[[], bool], limit: float) -> None:
    deadline = time.monotonic() + limit
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_an_action_that_is_not_a_number_reaches_no_environment(collect: Collector) -> None:
    cast = agents(collect.world.env, 2)
    cast = eqx.tree_at(lambda x: x.context.mean, cast, cast.context.mean.at[1].set(jnp.nan))
    reason = r"stranger, task 1, episode \d, step 0: the policy's action must be finite"
    with pytest.raises(EpisodeError, match=reason):
        collect(keys(2, SEED), cast, jnp.array([0, 1]))


def test_an_environment_that_cannot_be_closed_for_the_next_task_is_named(tmp_path: Path) -> None:
    family = family_of(partial(Diarist, tmp_path / "diary"))
    tasks = TaskSet(rows()[:2])
    play(family.make_env(), tasks, [0], episodes=1, num_threads=1)
    reason = "stranger, task 1, episode 0, step 0: `close` raised OSError: the door is stuck"
    with pytest.raises(EpisodeError, match=reason):
        play(family.make_env(), tasks, [1], episodes=1, num_threads=1)


def test_a_command_says_in_one_sentence_why_an_environment_cannot_be_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    family = family_of(partial(make_hopeless, "raises", tmp_path / "diary"))
    monkeypatch.setattr(strange_families, "hopeless", family, raising=False)
    command = ["train", "maesn", "--family", "strange_families:hopeless"]
    assert cli.run([*command, "--run", str(tmp_path / "run")]) == cli.USAGE_ERROR
    error = capsys.readouterr().err
    sentence, *note = error.splitlines()
    assert sentence.startswith("maesn train: `stranger`, task 0: `make_env` raised OSError: no lic")
    assert note[0] == "In the process of the environment:"
    assert re.search(r'strangers.py", line \d+, in make_hopeless$', note[-2])
    assert note[-1].strip() == 'raise OSError("no licence")'


def checked(make_env: Callable[[np.ndarray, str], object]) -> None:
    env = family_of(make_env).make_env()
    check_env_contract(env, rows()[0])


def test_an_environment_is_stepped_before_training_starts() -> None:
    checked(make_settable)
    reason = r"`stranger`, task 0: `step` raised ValueError: the gears are stuck"
    with pytest.raises(EnvContractError, match=reason) as error:
        checked(make_stuck)
    assert len(str(error.value)) < 1500  # of a message of ten million characters
    (note,) = error.value.__cause__.__notes__  # type: ignore[union-attr]
    assert note.index("in step") < note.index("in turn_gears") < note.index("raise ValueError(")
