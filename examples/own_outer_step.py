"""MAESN with an outer step of your own: the objective of ProMP (Rothfuss et al. 2019).

    export PYTHONPATH=examples
    maesn train own_outer_step:maesn_promp --family point --run runs/promp --iterations 60
    maesn adapt runs/promp --method own_outer_step:maesn_promp --reward dense

TRPO takes one step per meta-iteration. ProMP takes several, and keeps near the policy that played
in two ways: the adapted policy by clipped ratios, as PPO, and the policy before adaptation by a
penalty on its divergence (https://arxiv.org/abs/1810.06784, equation 13). The inner step stays
MAESN's own.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

import maesn


class ProMP(maesn.ProximalOuterStep):
    """Several gradient steps on clipped ratios, with a penalty on the divergence before adaptation.

    The other settings have ProMP's values as defaults: clip 0.3, five steps, learning rate 1e-3.
    """

    divergence_weight: float = 5e-4
    """Weight of the divergence of the policy before adaptation. ProMP's own value."""

    def loss(self, task: maesn.MetaObjective, parameters: maesn.MetaParameters) -> Float[Array, ""]:
        played, _ = task.pre[0]
        new = task.distributions_before(parameters)
        divergence = jnp.mean(played.behaviour.kl(new), where=played.valid)
        return super().loss(task, parameters) + self.divergence_weight * divergence


maesn_promp = maesn.maesn(outer=ProMP())
