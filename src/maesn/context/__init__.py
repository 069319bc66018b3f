"""The context slot: what a policy is conditioned on, and how it changes between tasks.

A context is a small set of parameters that belongs to one task and enters the policy as an
additional input. (The word is used as in CAVIA, for adapted parameters; in PEARL it means observed
transitions.) Four names, each with one meaning:

* *context settings* (`AbstractContextSettings`): how contexts start, what their penalty is, how z
  is differentiated;
* *context table*: what training learned, one row per training task or one for all;
* *context* (`AbstractContext`): the arrays of one task, or of many, stacked;
* *z*: what a context feeds to the policy throughout one episode.

`NoContext`, `BiasContext` and `LatentContext` span the methods of the paper, and `OracleContext`
gives their ceiling: `maesn.learners.presets` says which method has which.
"""

from maesn.context.settings import AbstractContextSettings as AbstractContextSettings
from maesn.context.settings import BiasContext as BiasContext
from maesn.context.settings import LatentContext as LatentContext
from maesn.context.settings import NoContext as NoContext
from maesn.context.settings import OracleContext as OracleContext
from maesn.context.values import AbstractContext as AbstractContext
from maesn.context.values import Bias as Bias
from maesn.context.values import Latent as Latent
from maesn.context.values import LatentPerEpisode as LatentPerEpisode
from maesn.context.values import Nothing as Nothing
from maesn.context.values import TaskDescription as TaskDescription
from maesn.context.values import held_at as held_at
