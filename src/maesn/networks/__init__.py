"""Function approximators: pytrees of arrays with a `__call__` for one input."""

from maesn.networks.bayesian import BayesianNetwork as BayesianNetwork
from maesn.networks.bayesian import init_bayesian_network as init_bayesian_network
from maesn.networks.gru import GRU as GRU
from maesn.networks.gru import init_gru as init_gru
from maesn.networks.mlp import MLP as MLP
from maesn.networks.mlp import Linear as Linear
from maesn.networks.mlp import init_mlp as init_mlp
from maesn.networks.recurrent import HyperMLP as HyperMLP
from maesn.networks.recurrent import RecurrentNetwork as RecurrentNetwork
from maesn.networks.recurrent import hyper_mlp as hyper_mlp
from maesn.networks.recurrent import init_recurrent_network as init_recurrent_network
