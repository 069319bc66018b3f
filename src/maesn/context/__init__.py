"""The context slot: what a policy is conditioned on, and how it changes between tasks.

A context is a small set of parameters that belongs to one task and enters the policy as an
additional input. (The word is used as in CAVIA, for adapted parameters; in PEARL it means observed
transitions.) Four names, each with one meaning:

* *context settings* (`AbstractContextSettings`): how contexts start, what their penalty is, how z
  is differentiated;
* *context table*: what training learned, one row per training task or one for all;
* *context* (`AbstractContext`): the arrays of one task, or of many, stacked;
* *z*: what a context feeds to the policy throughout one episode.

Three settings span the methods of the paper, and a fourth one gives their ceiling:

* `NoContext`: nothing. With adapted policy weights this is MAML.
* `BiasContext`: a deterministic vector shared by all tasks. This is MAML with a bias
  transformation (appendix "Ablation Study").
* `LatentContext`: a Gaussian per training task, from which one z is drawn per episode. This is
  MAESN (section "Meta-Learning Latent Variable Policies") and, without an inner update,
  LatentSpace.
* `OracleContext`: the task itself. This is the oracle, which has nothing to find out.
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
