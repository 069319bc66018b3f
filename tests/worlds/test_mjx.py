"""Episodes on the accelerator's engine against the native one, a closed form, and failures."""

from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from carts import MOTOR, RUNAWAY, TIME_STEP, CartTask, cart_on, pushed
from playing import agents, keys, play

from maesn.axes import Readings
from maesn.envs import Point, TaskSet, point, wheeled
from maesn.worlds import EpisodeError, make_world

TASKS = wheeled.task_set("test")
TASK_INDEX = [17, 3]
CARTS = TaskSet(CartTask(np.float32([0.0, 5.0, 0.0]), np.float32([1.0, 2.0, 8.0])))


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_tasks_may_change_the_dynamics(engine: Any, tmp_path: Path) -> None:
    env = cart_on(tmp_path, MOTOR)(force=3.0)
    task_index, count = [2, 0, 1], 2
    cast = agents(env, 3)
    episodes = play(env, CARTS, task_index, episodes=count, cast=cast, engine=engine)
    steps = np.arange(env.horizon + 1)
    for slot, (key, index) in enumerate(zip(keys(3), task_index, strict=True)):
        for episode in range(count):
            start_key = jax.random.split(jax.random.fold_in(key, episode), 3)[1]
            first = float(CARTS[index].speed) * bool(pushed(start_key))
            change = TIME_STEP * 3.0 / float(CARTS[index].mass)
            # v_t = v_0 + h a t and x_t = sum_{s = 1 ... t} h v_s = h v_0 t + h^2 a t (t + 1) / 2
            speed = first + change * steps
            place = TIME_STEP * (first * steps + change * steps * (steps + 1) / 2)
            np.testing.assert_allclose(
                episodes.observation[slot, episode],
                np.stack([place, speed], axis=-1),
                rtol=1e-5,
                atol=1e-6,
            )


def test_physics_that_blows_up_is_named(tmp_path: Path) -> None:
    # The speed grows tenfold a step from 5 m/s, so it is above the limit of 1e10 after step 9.
    env = cart_on(tmp_path, RUNAWAY)()
    start_keys = [
        jax.random.split(jax.random.fold_in(keys(2)[1], episode), 3)[1] for episode in range(5)
    ]
    episode = [bool(pushed(key)) for key in start_keys].index(True)
    light = TaskSet(CartTask(np.float32([0, 5, 0]), np.float32([1, 1, 1])))
    with pytest.raises(EpisodeError, match=f"cart, task 1, episode {episode}, step 9: control and"):
        play(env, light, [2, 1], episodes=5, engine="mjx")


@pytest.mark.long  # `test_endings` does it with the native engine
def test_what_blows_up_after_its_end_is_no_error(tmp_path: Path) -> None:
    class Ending(cart_on(tmp_path, RUNAWAY)):  # type: ignore[misc]
        name: ClassVar[str] = "ending cart"

        def control(self, action: jax.Array) -> jax.Array:
            return jnp.full(1, jnp.where(jnp.isfinite(action).all(), 0.0, jnp.nan))

        def terminated(self, readings: Readings) -> jax.Array:
            return jnp.abs(readings["qvel"][0]) > 1e3

    episodes = play(Ending(), CARTS, [1, 2], episodes=5, engine="mjx")
    assert episodes.terminated[0].any()
    assert not episodes.terminated[1].any()
    assert np.isfinite(np.asarray(episodes.reward)[np.asarray(episodes.valid)]).all()


def test_a_field_that_is_not_finite_is_named(tmp_path: Path) -> None:
    env = cart_on(tmp_path, MOTOR)(force=3.0)
    broken = TaskSet(CartTask(np.float32([0.0, 0.0]), np.float32([1.0, np.nan])))
    with pytest.raises(EpisodeError, match="cart, task 1, episode 0, step 0: `body_mass` must be"):
        play(env, broken, [0, 1], cast=agents(env, 2), engine="mjx")


def test_families_without_a_model_have_one_engine() -> None:
    with pytest.raises(ValueError, match='`engine` must be "native" for `point`'):
        make_world(Point(), point.task_set("test"), engine="mjx")
