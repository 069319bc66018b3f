"""Environments and the families of tasks that they are asked to solve."""

from maesn.envs.base import AbstractEnv as AbstractEnv
from maesn.envs.base import AbstractMujocoEnv as AbstractMujocoEnv
from maesn.envs.base import AbstractPureEnv as AbstractPureEnv
from maesn.envs.base import AnyEnv as AnyEnv
from maesn.envs.base import Reward as Reward
from maesn.envs.base import RewardKind as RewardKind
from maesn.envs.base import Variant as Variant
from maesn.envs.catalogue import FAMILIES as FAMILIES
from maesn.envs.catalogue import PROBES as PROBES
from maesn.envs.catalogue import find_family as find_family
from maesn.envs.point import Point as Point
from maesn.envs.point import point as point
from maesn.envs.probes import HiddenEnd as HiddenEnd
from maesn.envs.probes import HiddenSide as HiddenSide
from maesn.envs.probes import hidden_end as hidden_end
from maesn.envs.probes import hidden_side as hidden_side
from maesn.envs.target_probes import DelayedTarget as DelayedTarget
from maesn.envs.target_probes import HiddenTarget as HiddenTarget
from maesn.envs.target_probes import delayed_target as delayed_target
from maesn.envs.target_probes import hidden_target as hidden_target
from maesn.envs.tasks import SETS as SETS
from maesn.envs.tasks import SetName as SetName
from maesn.envs.tasks import TaskFamily as TaskFamily
from maesn.envs.tasks import TaskSet as TaskSet
from maesn.envs.wheeled import Wheeled as Wheeled
from maesn.envs.wheeled import wheeled as wheeled
