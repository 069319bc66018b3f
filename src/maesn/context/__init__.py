"""The context slot: what a policy is conditioned on, and how it changes between tasks.

A context is a small set of parameters that belongs to one task and enters the policy as an
additional input. (The word is used as in CAVIA, for adapted parameters; in PEARL it means observed
transitions.) Three fillings span the methods of the paper, and a fourth
one gives their ceiling:

* `NoContext`: nothing. With adapted policy weights this is MAML.
* `BiasContext`: a deterministic vector shared by all tasks. This is MAML with a bias
  transformation (appendix "Ablation Study").
* `LatentContext`: a Gaussian per training task, from which one z is drawn per episode. This is
  MAESN (section "Meta-Learning Latent Variable Policies") and, without an inner update,
  LatentSpace.
* `OracleContext`: the task itself. This is the oracle, which has nothing to find out.

Each filling comes as two types. The *settings* (`AbstractContextSettings`) know how contexts start
and what they cost. The *values* (`AbstractContext`) hold the arrays of one task.
"""

from maesn.context.settings import AbstractContextSettings as AbstractContextSettings
from maesn.context.settings import BiasContext as BiasContext
from maesn.context.settings import LatentContext as LatentContext
from maesn.context.settings import NoContext as NoContext
from maesn.context.settings import OracleContext as OracleContext
from maesn.context.values import AbstractContext as AbstractContext
from maesn.context.values import Bias as Bias
from maesn.context.values import Latent as Latent
from maesn.context.values import Nothing as Nothing
from maesn.context.values import TaskDescription as TaskDescription
