"""Search in the latent space: the archive, what training tasks return for it, and the learner."""

from maesn.runtime.search import SearchSettings as SearchSettings
from maesn.search.learner import SearchFastLearner as SearchFastLearner
from maesn.search.learner import latent_of as latent_of
from maesn.search.prior import PriorSettings as PriorSettings
from maesn.search.prior import make_prior as make_prior
from maesn.search.prior import play_archive as play_archive
