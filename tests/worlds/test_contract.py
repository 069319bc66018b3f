"""What an environment of one's own does wrong is said in its own terms."""

import jax.numpy as jnp
import pytest
from jaxtyping import Array

from maesn.envs import Point, point
from maesn.worlds import EnvContractError, check_env_contract


class Crossed(Point):
    """A point whose actuators take another number of actions than it declares."""

    def control(self, action: Array) -> Array:
        return jnp.ones((2, 3)) @ action


def test_a_control_of_another_size_is_named() -> None:
    task = point.task_set("test")[0]
    check_env_contract(Point(), task)
    with pytest.raises(EnvContractError, match="`control` must take an action of `action_size` 2"):
        check_env_contract(Crossed(), task)
