"""The rule that searches the latent space, and a control that knows no single training task."""

from typing import ClassVar

from maesn.envs import AnyEnv
from maesn.rules.base import AbstractRule, Budget, Trained
from maesn.runtime.return_model import ReturnModel, ReturnPrior
from maesn.search import SearchFastLearner, SearchSettings, latent_of


class SearchRule(AbstractRule):
    """Search for the best latent, with the returns of the training tasks as the prior.

    Plays one latent per episode, and deploys the one with the highest posterior mean. If an update
    learns from several episodes, they are of different latents, which are proposed together (
    `docs/explanation/methods/latent_search.md`).
    """

    budget: ClassVar[Budget] = Budget(20, 1, 5)
    needs_return_prior: ClassVar[bool] = True
    label = "search"

    settings: SearchSettings = SearchSettings()
    """Settings of the search itself, written in place: `--rule search exploration=1`."""
    prior: str = ""
    """File of the prior, as `maesn prior` writes it; empty: the run's own, made where missing."""
    any_reward: bool = False
    """Whether a prior that was made for another reward or radius will do."""

    def check_budget(self, episodes: int, episodes_per_update: int) -> None:
        if episodes < 1:
            raise ValueError(f"a search needs `episodes` of at least 1, got {episodes}.")

    def fast_learner(self, trained: Trained, env: AnyEnv) -> SearchFastLearner:
        latent = latent_of(trained.fast_learner())
        if trained.return_prior is None:
            raise ValueError("a search needs a prior over returns, which is made of a run.")
        model = self.model(trained.return_prior(self.prior, self.any_reward))
        return SearchFastLearner(latent, model, self.settings, trained.per_update)

    def model(self, prior: ReturnPrior) -> ReturnModel:
        """Return the model of the returns in a new task."""
        return self.settings.model(prior)


class StationaryRule(SearchRule):
    """Search as `search` does, with one Gaussian process that knows no training task.

    Its mean is the average over training tasks, its kernel stationary with their variance.
    """

    label = "stationary process"

    settings: SearchSettings = SearchSettings(familiar=1.0)

    def model(self, prior: ReturnPrior) -> ReturnModel:
        return self.settings.model(prior).unlike(wider=1.0, shifted=False)
