"""The families that come with the library, by name."""

from maesn.envs.point import point
from maesn.envs.tasks import TaskFamily
from maesn.envs.wheeled import wheeled

FAMILIES: dict[str, TaskFamily] = {family.name: family for family in (point, wheeled)}
