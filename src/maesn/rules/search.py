"""The rule that searches the latent space, and the prior over returns that it needs."""

import dataclasses
from typing import Any, ClassVar

from maesn.envs import AnyEnv
from maesn.learners import AbstractFastLearner
from maesn.rules.base import AbstractRule, Budget, Trained
from maesn.runtime.search import AcquisitionName, SearchSettings
from maesn.search import SearchFastLearner, latent_of

_USUAL = SearchSettings()


class SearchRule(AbstractRule):
    """Search for the best latent, with the returns of the training tasks as the prior.

    Plays one latent per episode, and deploys the one with the highest posterior mean
    (`docs/explanation/methods/latent_search.md`).
    """

    budget: ClassVar[Budget] = Budget(20, 1, 5)
    needs_return_prior: ClassVar[bool] = True

    acquisition: AcquisitionName = _USUAL.acquisition
    """How the next latent is chosen: `ucb` by the upper confidence bound; `thompson` draws a
    training task by its posterior probability and takes that task's best latent."""
    exploration: float = _USUAL.exploration
    """Weight of the posterior's standard deviation in the upper confidence bound."""
    draws: int = _USUAL.draws
    """Latents that are drawn around the best one, once it has been played; 0: the archive alone."""
    draw_std: float = _USUAL.draw_std
    """Standard deviation of these draws."""
    residual: float = _USUAL.residual
    """Variance of a new task's returns that no training task explains, as a share of the variance
    over training tasks."""
    length_scale: float = _USUAL.length_scale
    """Distance in z over which returns vary."""
    prior: str = ""
    """File of the prior, as `maesn prior` writes it; empty: the run's own, made where missing."""
    any_reward: bool = False
    """Whether a prior that was made for another reward or radius will do."""

    def __check_init__(self) -> None:
        _ = self.settings  # checks the values

    @property
    def settings(self) -> SearchSettings:
        """The settings of the search itself."""
        names = [field.name for field in dataclasses.fields(SearchSettings)]
        return SearchSettings(**{name: getattr(self, name) for name in names})

    def check_budget(self, episodes: int, episodes_per_update: int) -> None:
        if episodes < 1:
            raise ValueError(f"a search needs `episodes` of at least 1, got {episodes}.")

    @property
    def label(self) -> str:
        return "search"

    def fast_learner(self, trained: Trained, env: AnyEnv) -> AbstractFastLearner[Any]:
        latent = latent_of(trained.fast_learner())
        if trained.return_prior is None:
            raise ValueError("a search needs a prior over returns, which is made of a run.")
        prior = trained.return_prior(self.prior, self.any_reward)
        settings = self.settings
        model = settings.model(prior)
        return SearchFastLearner(latent, model, settings)
