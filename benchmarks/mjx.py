"""Collection rate and seconds per meta-iteration of the engine `mjx`, on whatever device JAX has.

    python benchmarks/mjx.py                        all families, as their models say
    python benchmarks/mjx.py --sweep                and with what may be left out, one by one
    python benchmarks/mjx.py --families ant --episodes-per-task 50 --meta-batch-size 40

A step is one control step of one simulation, policy and readings included, in a collection of
`meta_batch_size` x `episodes_per_task` episodes; a meta-iteration is all that training does.
Compilation is excluded and reported apart.

`--sweep` varies `MjxLimits`. A constraint solver that stops earlier, and contacts that are not
looked for, change the physics if they go too far. So beside the rate stands how far episodes end
from where those of the unlimited engine end, given the same actions' draws: the mean distance in
metres of the planar positions. The geoms that are left untouched are these:

* `wheeled`: the car's box. The wheels hold it 0.15 m above the floor, and it cannot tilt.
* `ant`: the upper segments of the legs. They touch the floor only in falls, which mostly end an
  episode; whether that matters is what the distance tells.
* `blockpush`: the tips of the gripper's arms, which lie inside the arms' round ends.
"""

import time
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from maesn.envs import AnyEnv, TaskSet, find_family
from maesn.experience.agent import Agents
from maesn.experience.episodes import Episodes
from maesn.learners import PRESETS, Problem
from maesn.physics.mjx import MjxLimits
from maesn.worlds import MjxWorld
from maesn.worlds.collector import Collector

_LEGS = tuple(f"{part}_{leg}" for part in ("leg", "thigh") for leg in range(1, 5))
_UNTOUCHED = {"wheeled": ("car",), "ant": _LEGS, "blockpush": ("right_tip", "left_tip")}


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    families: tuple[str, ...] = ("wheeled", "ant", "blockpush")
    """Families on a MuJoCo model."""
    meta_batch_size: int = 20
    """Tasks per meta-iteration."""
    episodes_per_task: int = 20
    """Episodes per task and collection."""
    repeats: int = 5
    """Timed collections and meta-iterations; the median counts."""
    sweep: bool = False
    """Also vary the solver's iterations and the contacts that are looked for."""


def variants(family: str, sweep: bool) -> dict[str, MjxLimits]:
    """Return what is timed of one family, by a name for the table."""
    whole = {"as the model says": MjxLimits()}
    if not sweep:
        return whole
    few = {
        f"solver {steps} x line search {searches}": MjxLimits(steps, searches)
        for steps, searches in ((1, 4), (2, 4), (4, 8), (8, 8), (20, 20))
    }
    untouched = _UNTOUCHED.get(family, ())
    fewer = {
        "fewer contacts": MjxLimits(untouched=untouched),
        "solver 4 x 8, fewer contacts": MjxLimits(4, 8, untouched),
    }
    return whole | few | (fewer if untouched else {})


class Timed:
    """A family on the engine with some limits."""

    def __init__(self, env: AnyEnv, tasks: TaskSet, limits: MjxLimits, settings: Settings) -> None:
        world: Any = MjxWorld(env, tasks, limits=limits)
        self.collect = Collector(world, settings.episodes_per_task)
        self._learner = PRESETS["maesn"](meta_batch_size=settings.meta_batch_size)
        self._settings = settings
        self._state = self._learner.init(
            jax.random.key(0), Problem(env.observation_size, env.action_size, len(tasks))
        )

    def play(self) -> Episodes:
        """Play one collection of the untrained policies."""
        count = self._settings.meta_batch_size
        agents: Agents = (
            self._learner.fast_learner(self._state)
            .init(jax.random.split(jax.random.key(1), count))
            .agents
        )
        keys = jax.random.split(jax.random.key(2), count)
        return jax.block_until_ready(self.collect(keys, agents, jnp.arange(count)))

    def iterate(self) -> None:
        """Do one meta-iteration."""
        self._state, _ = jax.block_until_ready(
            self._learner.step(jax.random.key(3), self._state, self.collect)
        )

    def seconds(self, what: Any) -> tuple[float, float]:
        """Return the time of the first call, with compilation, and the median of later ones."""
        times = []
        for _ in range(1 + self._settings.repeats):
            begin = time.perf_counter()
            what()
            times.append(time.perf_counter() - begin)
        return times[0], float(np.median(times[1:]))


def ends(env: AnyEnv, episodes: Episodes) -> np.ndarray:
    """Return where the episodes end, `[task, episode, 2]` in metres."""
    last = np.asarray(episodes.observation[..., -1, :])
    return np.asarray(jax.vmap(jax.vmap(env.position))(last))


def time_family(name: str, settings: Settings) -> None:
    """Print the table of one family."""
    family = find_family(name)
    env, tasks = family.make_env(reward_kind="dense"), family.task_set("training")
    simulations = settings.meta_batch_size * settings.episodes_per_task
    print(f"\n{name}: {simulations} simulations of {env.horizon} steps")
    print(
        f"{'':34s} {'steps/s':>9s} {'collect':>8s} {'meta-it.':>8s} {'compile':>8s} {'apart':>7s}"
    )
    reference: np.ndarray | None = None
    for label, limits in variants(name, settings.sweep).items():
        timed = Timed(env, tasks, limits, settings)
        first, collecting = timed.seconds(timed.play)
        first_iteration, whole = timed.seconds(timed.iterate)
        compiling = first - collecting + first_iteration - whole
        ended = ends(env, timed.play())
        reference = ended if reference is None else reference
        apart = np.linalg.norm(ended - reference, axis=-1).mean()
        rate = simulations * env.horizon / collecting
        print(
            f"{label:34s} {rate:9.0f} {collecting:7.2f}s {whole:7.2f}s {compiling:7.0f}s "
            f"{apart:7.3f}",
            flush=True,
        )


def main(settings: Settings) -> None:
    """Time all families."""
    device = jax.devices()[0]
    print(f"{device.platform}: {device.device_kind}; JAX {jax.__version__}")
    for name in settings.families:
        time_family(name, settings)


if __name__ == "__main__":
    main(tyro.cli(Settings))
