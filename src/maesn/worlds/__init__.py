"""Worlds: batched episodes of one family."""

from typing import Any

from maesn.envs.base import AbstractMujocoEnv, AnyEnv
from maesn.envs.tasks import TaskSet
from maesn.worlds.base import AbstractWorld as AbstractWorld
from maesn.worlds.base import Act as Act
from maesn.worlds.base import Actors as Actors
from maesn.worlds.base import Decision as Decision
from maesn.worlds.base import EpisodeError as EpisodeError
from maesn.worlds.base import Moment as Moment
from maesn.worlds.base import SimulationFailure as SimulationFailure
from maesn.worlds.base import Start as Start
from maesn.worlds.base import Trajectory as Trajectory
from maesn.worlds.device import DeviceWorld as DeviceWorld
from maesn.worlds.native import NativeWorld as NativeWorld


def make_world(env: AnyEnv, tasks: TaskSet, **options: Any) -> AbstractWorld:
    """Return the world that moves this kind of environment.

    Args:
        env: decides the engine: MuJoCo on the host, or JAX.
        tasks: the tasks that can be played.
        options: passed to the world, such as `num_threads` of `NativeWorld`.
    """
    if isinstance(env, AbstractMujocoEnv):
        return NativeWorld(env, tasks, **options)
    return DeviceWorld(env, tasks)
