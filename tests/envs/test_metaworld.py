"""Meta-World's families without Meta-World; `tests/simulators` has the rest."""

from pathlib import Path

import numpy as np
import pytest
from playing import play
from small_runs import tiny_maesn, tiny_settings

from maesn import cli
from maesn.envs import HOSTED, SETS, describe_env, find_family, is_own, rebuild_env
from maesn.envs.metaworld import CLEARANCE
from maesn.envs.sources import load_tasks
from maesn.foreign import InterfaceError
from maesn.runs.config import RunSettings, new_config
from maesn.storage import RunError
from maesn.worlds import EpisodeError

# As metaworld 3.1.1 has them in `_random_reset_space`: the object's start, then the goal.
BOUNDS = {
    "metaworld:reach": ([-0.1, 0.6, 0.02, -0.1, 0.8, 0.05], [0.1, 0.7, 0.02, 0.1, 0.9, 0.3]),
    "metaworld:push": ([-0.1, 0.6, 0.02, -0.1, 0.8, 0.01], [0.1, 0.7, 0.02, 0.1, 0.9, 0.02]),
    "metaworld:pick_place": ([-0.1, 0.6, 0.02, -0.1, 0.8, 0.05], [0.1, 0.7, 0.02, 0.1, 0.9, 0.3]),
}
DIGESTS = {
    "metaworld:reach": "b36c993e4245f7a1",
    "metaworld:push": "220334981f691572",
    "metaworld:pick_place": "7e02b17af6ed9a2b",
}


@pytest.mark.parametrize("name", HOSTED)
def test_tasks_are_those_of_meta_world_and_never_change(name: str) -> None:
    family, (low, high) = find_family(name), np.array(BOUNDS[name])
    sets = [family.task_set(which) for which in SETS]
    points = np.concatenate([tasks.tasks for tasks in sets])
    assert len(np.unique(points, axis=0)) == 100 * len(sets)
    assert (points >= low - 1e-6).all()
    assert (points <= high + 1e-6).all()
    assert np.ptp(points, axis=0) == pytest.approx(high - low, rel=0.05)
    assert np.hypot(*(points[:, 3:5] - points[:, :2]).T).min() >= CLEARANCE
    assert sets[0].digest() == DIGESTS[name]


def test_a_task_that_meta_world_would_draw_again_is_refused(tmp_path: Path) -> None:
    near = np.float32([[0, 0.6, 0.02, 0, 0.9, 0.1], [0, 0.7, 0.02, 0.1, 0.8, 0.1]])
    np.savez(tmp_path / "near.npz", points=near)
    with pytest.raises(RunError, match=r"at least 0.15 m from .* got 0.141 m in row 1"):
        load_tasks(tmp_path / "near.npz", HOSTED["metaworld:reach"])


@pytest.mark.parametrize("name", HOSTED)
def test_all_but_playing_needs_no_meta_world(name: str) -> None:
    """A family with a colon in its name is the library's, and runs of it need no module."""
    family = find_family(name)
    env = family.make_env(reward_kind="sparse")
    assert (env.observation_size, env.action_size, env.horizon) == (39, 4, 500)
    assert rebuild_env(family, describe_env(env)) == env
    settings = tiny_settings(family=name)
    assert settings.own_family is None
    config = new_config(settings, tiny_maesn(), family, family.task_set("training"))
    assert config.family == name
    assert ".venv" not in str(config.document())
    assert is_own("module:name")
    assert RunSettings(family="module:name").own_family == "module:name"


def test_what_is_missing_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where there is no `.venv-metaworld`
    monkeypatch.delenv("MAESN_PYTHON", raising=False)
    family = HOSTED["metaworld:push"]
    with pytest.raises((EpisodeError, InterfaceError), match="`make metaworld` installs") as error:
        play(family.make_env(), family.task_set("test", 1), [0], num_threads=1)
    assert "No module named 'metaworld'" in str(error.value)


def test_a_near_miss_is_no_module(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["train", "maesn", "--family", "metaworld:pish"]) == cli.USAGE_ERROR
    assert "Did you mean `metaworld:push`?" in capsys.readouterr().err
