"""Rules: what happens in a new task."""

from maesn.rules.base import AbstractRule as AbstractRule
from maesn.rules.base import AbstractWrapper as AbstractWrapper
from maesn.rules.base import Budget as Budget
from maesn.rules.base import Trained as Trained
from maesn.rules.prescribed import FixedAgents as FixedAgents
from maesn.rules.prescribed import GradientRule as GradientRule
from maesn.rules.prescribed import NoAdaptation as NoAdaptation
from maesn.rules.search import SearchRule as SearchRule
from maesn.rules.search import StationaryRule as StationaryRule
from maesn.rules.text import KNOWN as KNOWN
from maesn.rules.text import from_text as from_text
from maesn.rules.text import paths_of as paths_of
from maesn.rules.text import written_out as written_out
from maesn.rules.wrappers import ThenTrpo as ThenTrpo
from maesn.rules.wrappers import VimeBonus as VimeBonus
