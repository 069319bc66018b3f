"""Environments and the families of tasks that they are asked to solve."""

from maesn.envs.ant import Ant as Ant
from maesn.envs.ant import ant as ant
from maesn.envs.base import AbstractEnv as AbstractEnv
from maesn.envs.base import AbstractMujocoEnv as AbstractMujocoEnv
from maesn.envs.base import AbstractPureEnv as AbstractPureEnv
from maesn.envs.base import AnyEnv as AnyEnv
from maesn.envs.base import Reward as Reward
from maesn.envs.base import RewardKind as RewardKind
from maesn.envs.base import Variant as Variant
from maesn.envs.blockpush import BlockPush as BlockPush
from maesn.envs.blockpush import BlockPushTask as BlockPushTask
from maesn.envs.blockpush import blockpush as blockpush
from maesn.envs.catalogue import FAMILIES as FAMILIES
from maesn.envs.catalogue import find_family as find_family
from maesn.envs.point import Point as Point
from maesn.envs.point import point as point
from maesn.envs.recorded import EnvRecord as EnvRecord
from maesn.envs.recorded import describe_env as describe_env
from maesn.envs.recorded import rebuild_env as rebuild_env
from maesn.envs.tasks import NAMED_SETS as NAMED_SETS
from maesn.envs.tasks import SETS as SETS
from maesn.envs.tasks import SetName as SetName
from maesn.envs.tasks import TaskFamily as TaskFamily
from maesn.envs.tasks import TaskSet as TaskSet
from maesn.envs.wheeled import Wheeled as Wheeled
from maesn.envs.wheeled import wheeled as wheeled
