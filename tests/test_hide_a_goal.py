"""The page "Hide a goal": its rewards are those of the environments, its file is up to date."""

import json
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scripts import ROOT, load_script

from maesn.envs import ant, blockpush, wheeled

SOURCES = ROOT / "docs/hide_a_goal"


@pytest.fixture
def build(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(SOURCES)
    return load_script("docs/hide_a_goal/build.py")


def test_the_page_holds_its_sources_and_its_own_prior(build: ModuleType) -> None:
    page = build.PAGE.read_text("utf-8")
    for path in build.SOURCES:
        assert path.read_text("utf-8") in page
    robots = {
        robot.name: robot
        for robot in load_script("docs/hide_a_goal/games.py").read_page(build.PAGE)
    }
    assert list(robots) == list(build.REWARDS)
    for name in ("wheeled", "ant"):
        robot = robots[name]
        own = build.prior_of(robot.scenes[0][0], robot)
        np.testing.assert_array_equal(own.excess, robot.prior.excess)
        np.testing.assert_allclose(own.noise, robot.prior.noise, rtol=1e-12)
    again = build.Robot.of(json.loads(json.dumps(robots["blockpush"].document())))
    (first, _), (second, _) = again.scenes[2], robots["blockpush"].scenes[2]
    np.testing.assert_array_equal(first.tracks, second.tracks)


@pytest.mark.parametrize("family", [wheeled, ant, blockpush])
def test_a_goal_adds_what_it_does_in_the_environment(build: ModuleType, family: object) -> None:
    env = family.make_env(reward_kind="sparse")
    task = jax.tree.map(jnp.asarray, family.task_set("test")[3])
    goal = np.asarray(env.goal(task), np.float64)
    track = 1 + int(task.block) if env.name == "blockpush" else 0
    drawn = np.random.default_rng(0).normal(scale=env.sparse_radius / build.UNIT, size=(2, 60))
    path = np.round(goal[:, None] / build.UNIT + drawn).astype(np.int16)
    tracks = np.zeros((1, 1, 6, 2, 61), np.int16)
    tracks[0, 0, track, :, 1:] = path
    recording = build.Recording(np.zeros((1, 2)), tracks, np.array([[50]]), np.zeros((1, 1)))
    robot = build.Robot(
        env.name, env.sparse_radius, env.horizon, *build.REWARDS[env.name], None, None, ()
    )
    added, reached = robot.goal_returns(recording, goal, track)
    rewards = [env.reward(*_readings(env, at * build.UNIT, task), task).goal for at in path.T[:50]]
    near = np.linalg.norm(path[:, :50].T * build.UNIT - goal, axis=1) <= env.sparse_radius
    assert 5 < near.sum() < 45
    assert reached == [[True]]
    np.testing.assert_allclose(added, [[np.sum(rewards)]], rtol=1e-5)


def _readings(env: object, place: np.ndarray, task: object) -> tuple[object, ...]:
    """Readings, action and readings after it, in which what is judged stands at a place."""
    sizes = {"wheeled": (6, 6), "ant": (15, 14), "blockpush": (13, 13)}[env.name]
    qpos, qvel = (np.zeros(size, np.float32) for size in sizes)
    held = {"qpos": qpos, "qvel": qvel}
    if env.name == "ant":
        centre = np.zeros((14, 3), np.float32)
        centre[:, :2] = place
        held |= {"subtree_com": centre, "cfrc_ext": np.zeros((14, 6), np.float32)}
    elif env.name == "blockpush":
        block = int(task.block)
        qpos[3 + 2 * block : 5 + 2 * block] = place - [0.2 * (block + 1), 0.0]
    else:
        qpos[:2] = place
    held = jax.tree.map(jnp.asarray, held)
    return held, jnp.zeros(env.action_size), held
