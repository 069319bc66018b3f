"""A control of a search: it has no hypothesis about single training tasks."""

from maesn.rules.search import SearchRule
from maesn.runtime.return_model import ReturnModel, ReturnPrior
from maesn.search import SearchSettings


class StationaryRule(SearchRule):
    """Search as `search` does, with one Gaussian process that knows no training task.

    Its mean is the average over training tasks, its kernel stationary with their variance.
    """

    settings: SearchSettings = SearchSettings(familiar=1.0)

    @property
    def label(self) -> str:
        return "stationary process"

    def model(self, prior: ReturnPrior) -> ReturnModel:
        return self.settings.model(prior).unlike(wider=1.0, shifted=False)
