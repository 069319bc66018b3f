"""Mathematics, without objects of reinforcement learning and without simulators."""

from maesn.numerics.categorical import Categorical as Categorical
from maesn.numerics.conjugate_gradient import conjugate_gradient as conjugate_gradient
from maesn.numerics.distribution import AbstractDistribution as AbstractDistribution
from maesn.numerics.first_order import first_order_step as first_order_step
from maesn.numerics.first_order import if_finite as if_finite
from maesn.numerics.gaussian import DiagonalGaussian as DiagonalGaussian
from maesn.numerics.minibatch_descent import MinibatchDescent as MinibatchDescent
from maesn.numerics.products import multiply as multiply
from maesn.numerics.returns import discounted_returns as discounted_returns
from maesn.numerics.returns import generalized_advantages as generalized_advantages
from maesn.numerics.returns import masked_mean as masked_mean
from maesn.numerics.returns import standardize as standardize
from maesn.numerics.returns import trial_advantages as trial_advantages
from maesn.numerics.ridge import ridge_regression as ridge_regression
from maesn.numerics.ring import Ring as Ring
from maesn.numerics.squashed_gaussian import SquashedGaussian as SquashedGaussian
from maesn.numerics.threads import at_once as at_once
