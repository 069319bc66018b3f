"""What the camera sees of tasks and episodes, and pictures of what MuJoCo does not move."""

from contextlib import closing
from functools import partial

import jax
import numpy as np
from pictures import drawn

from maesn.envs import FAMILIES
from maesn.envs.blockpush import BlockPush
from maesn.envs.point import Point
from maesn.worlds import Scene, arena


def test_the_camera_sees_the_task_and_does_not_follow_who_goes_astray() -> None:
    env, task = BlockPush(), FAMILIES["blockpush"].task_set("test")[0]
    rows = jax.tree.map(lambda x: np.asarray(x)[None], task)
    objects, goal = np.asarray(env.landmarks(task)), np.asarray(env.goal(task))
    views = []
    for distance in (0.1, 50.0):
        qpos = np.zeros((2, 13))
        qpos[1, 0] = distance
        views.append(np.array(arena(env, rows, {"qpos": qpos, "qvel": np.zeros((2, 13))})))
    needed = [*objects, goal - env.sparse_radius, goal + env.sparse_radius, np.zeros(2)]
    for lower, upper in views:
        assert (np.array(needed) >= lower - 1e-6).all()
        assert (np.array(needed) <= upper + 1e-6).all()
    np.testing.assert_array_equal(*views)


def ball(size: float) -> np.ndarray:
    """Return a picture of a point in a world of some metres."""
    env = Point(sparse_radius=0.5 * size)
    goal, path = size * np.array([0.0, 2.0]), size * np.array([[0.0, 0.0], [1.0, 1.0]])
    states = {"qpos": path, "qvel": np.zeros((2, 2))}
    with closing(Scene(env, arena(env, goal[None], states), 60, 40)) as scene:
        return scene.draw(jax.tree.map(lambda x: x[-1], states), goal, path)


def test_a_ball_looks_the_same_in_a_world_of_any_size() -> None:
    small, usual, large = (drawn(partial(ball, size)) for size in (1e-2, 1.0, 1e2))
    if small is not None and usual is not None and large is not None:
        np.testing.assert_allclose(small.astype(int), usual.astype(int), atol=3)
        np.testing.assert_allclose(large.astype(int), usual.astype(int), atol=3)
        assert np.ptp(usual) > 100


def test_a_robot_whose_tasks_are_no_places_is_followed_by_its_own_camera() -> None:
    env, task = FAMILIES["cheetah_vel"].make_env(), FAMILIES["cheetah_vel"].task_set("test")[0]
    assert arena(env, np.asarray(task)[None], {"qpos": np.zeros((1, 9))}) is None

    def pictures() -> list[np.ndarray]:
        with closing(Scene(env, None, 60, 40)) as scene:
            # The floor repeats every 80 / 60 m, of which 8 m are six.
            poses = np.zeros((3, 9))
            poses[1, 0], poses[2, 2] = 8.0, 0.5  # elsewhere, and nose down
            return [scene.draw({"qpos": pose}, task).astype(float) for pose in poses]

    shown = drawn(pictures)
    if shown is not None:
        here, there, down = shown
        assert np.abs(here - there).mean() < 0.5 * np.abs(here - down).mean()
