"""The rule that searches the latent space, and the prior over returns that it needs."""

from typing import ClassVar

from maesn.envs import AnyEnv
from maesn.rules.base import AbstractRule, Budget, Trained
from maesn.runtime.return_model import ReturnModel, ReturnPrior, UnlikeModel
from maesn.search import SearchFastLearner, SearchSettings, latent_of


class SearchRule(AbstractRule):
    """Search for the best latent, with the returns of the training tasks as the prior.

    Plays one latent per episode, and deploys the one with the highest posterior mean. If an update
    learns from several episodes, they are of different latents, which are proposed together (
    `docs/explanation/methods/latent_search.md`).
    """

    budget: ClassVar[Budget] = Budget(20, 1, 5)
    needs_return_prior: ClassVar[bool] = True

    settings: SearchSettings = SearchSettings()
    """Settings of the search itself, written in place: `--rule search exploration=1`."""
    prior: str = ""
    """File of the prior, as `maesn prior` writes it; empty: the run's own, made where missing."""
    any_reward: bool = False
    """Whether a prior that was made for another reward or radius will do."""

    def check_budget(self, episodes: int, episodes_per_update: int) -> None:
        if episodes < 1:
            raise ValueError(f"a search needs `episodes` of at least 1, got {episodes}.")

    @property
    def label(self) -> str:
        return "search"

    def fast_learner(self, trained: Trained, env: AnyEnv) -> SearchFastLearner:
        latent = latent_of(trained.fast_learner())
        if trained.return_prior is None:
            raise ValueError("a search needs a prior over returns, which is made of a run.")
        model = self.model(trained.return_prior(self.prior, self.any_reward))
        return SearchFastLearner(latent, model, self.settings, trained.per_update)

    def model(self, prior: ReturnPrior) -> ReturnModel | UnlikeModel:
        """Return the model of the returns in a new task."""
        return self.settings.model(prior)
