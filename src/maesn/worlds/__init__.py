"""Worlds: batched episodes of one family."""

from maesn.envs.base import AbstractMujocoEnv, AbstractPureEnv, AnyEnv
from maesn.envs.base import Start as Start
from maesn.envs.hosted import AbstractGymnasiumEnv
from maesn.envs.tasks import TaskSet
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
from maesn.worlds.scene import Scene as Scene
from maesn.worlds.scene import arena as arena
from maesn.worlds.scene import places as places
from maesn.worlds.stepping import AbstractStepper, DeviceStepper, NativeStepper


def make_world(env: AnyEnv, tasks: TaskSet, num_threads: int = 0) -> AbstractWorld:
    """Return the world that moves this kind of environment.

    Args:
        env: decides what moves it: MuJoCo, JAX, or processes of foreign environments.
        tasks: the tasks that can be played.
        num_threads: threads or processes that play; 0 means one for each CPU. JAX has its own.
    """
    if isinstance(env, AbstractPureEnv):
        return DeviceWorld(env, tasks)
    return HostWorld(env, tasks, open_stepper(env, num_threads))


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
