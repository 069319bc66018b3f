"""Worlds: batched episodes of one family."""

from collections.abc import Callable
from typing import Any, Literal, TypeAlias

from maesn.envs.base import AbstractMujocoEnv, AbstractPureEnv, AnyEnv
from maesn.envs.base import Start as Start
from maesn.envs.hosted import AbstractGymnasiumEnv
from maesn.envs.tasks import TaskSet
from maesn.settings import check_choice
from maesn.worlds.base import AbstractWorld as AbstractWorld
from maesn.worlds.base import Act as Act
from maesn.worlds.base import Actors as Actors
from maesn.worlds.base import Decision as Decision
from maesn.worlds.base import EnvContractError as EnvContractError
from maesn.worlds.base import EpisodeError as EpisodeError
from maesn.worlds.base import Moment as Moment
from maesn.worlds.base import SimulationFailure as SimulationFailure
from maesn.worlds.base import Trajectory as Trajectory
from maesn.worlds.contract import check_env_contract as check_env_contract
from maesn.worlds.contract import check_policy as check_policy
from maesn.worlds.device import DeviceWorld as DeviceWorld
from maesn.worlds.foreign import HostedStepper
from maesn.worlds.host import HostWorld as HostWorld
from maesn.worlds.mjx import MjxWorld as MjxWorld
from maesn.worlds.scene import Scene as Scene
from maesn.worlds.scene import arena as arena
from maesn.worlds.scene import places as places
from maesn.worlds.stepping import AbstractStepper as AbstractStepper
from maesn.worlds.stepping import DeviceStepper, NativeStepper


def _host_world(env: AnyEnv, tasks: TaskSet, num_threads: int) -> AbstractWorld:
    return HostWorld(env, tasks, open_stepper(env, num_threads))


# What moves an environment -> the world in which it does.
_WORLDS: dict[str, Callable[[Any, TaskSet, int], AbstractWorld]] = {
    "gymnasium": _host_world,
    "jax": DeviceWorld,
    "mujoco.batch": _host_world,
    "mujoco.mjx": MjxWorld,
}

EngineName: TypeAlias = Literal["native", "mjx"]
"""`native` is each environment's own engine; `mjx` moves MuJoCo's models on an accelerator."""


def engine_of(env: AnyEnv, engine: EngineName = "native") -> str:
    """Return what moves an environment, as run directories record it.

    Raises:
        ValueError: there is no such engine, or it cannot move the environment.
    """
    check_choice("engine", engine, EngineName)
    if engine == "native":
        return env.engine
    if env.engine == "mujoco.batch":
        return "mujoco.mjx"
    raise ValueError(
        f'`engine` must be "native" for `{env.name}`, which is moved by {env.engine}, got '
        f'{engine!r}: "mjx" is for families on a MuJoCo model alone'
    )


def make_world(
    env: AnyEnv, tasks: TaskSet, num_threads: int = 0, engine: EngineName = "native"
) -> AbstractWorld:
    """Return the world that moves this kind of environment.

    Args:
        env: decides the engine: MuJoCo on the host, JAX, or processes of foreign environments.
        tasks: the tasks that can be played.
        num_threads: threads or processes that play; 0 means one for each CPU.
        engine: "mjx" moves a MuJoCo environment on the accelerator instead of on the host.

    Raises:
        EngineError: the engine is not installed.
        ValueError: the engine cannot move the environment.
    """
    return _WORLDS[engine_of(env, engine)](env, tasks, num_threads)


def open_stepper(env: AnyEnv, num_threads: int = 0) -> AbstractStepper:
    """Return what moves this kind of environment in single steps.

    Args:
        env: decides what it is.
        num_threads: threads of the MuJoCo engine, or worker processes; 0 means one for each CPU.
    """
    if isinstance(env, AbstractGymnasiumEnv):
        return HostedStepper(env, num_threads)
    if isinstance(env, AbstractMujocoEnv):
        return NativeStepper(env, num_threads)
    assert isinstance(env, AbstractPureEnv)
    return DeviceStepper(env)
