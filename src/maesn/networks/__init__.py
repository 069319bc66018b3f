"""Function approximators: pytrees of arrays with a `__call__` for one input."""

from maesn.networks.mlp import MLP as MLP
from maesn.networks.mlp import Linear as Linear
from maesn.networks.mlp import init_mlp as init_mlp
