"""`maesn render`: the episodes are those of `maesn adapt`, and the files show them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import own_searches
import pytest
from pictures import assert_says_what_to_install, can_draw
from PIL import Image
from small_runs import tiny_maesn, tiny_settings
from strange_families import painters
from strangers import HORIZON

import maesn
from maesn import cli
from maesn.envs import Point
from maesn.evaluation import film
from maesn.evaluation.evaluation import Evaluation
from maesn.evaluation.film import Filmed, record_adaptation
from maesn.evaluation.running import new_tasks
from maesn.runs.run import Run
from maesn.worlds import EpisodeError
from maesn.worlds.collector import Collector

TASK, PLAYED, SHOWN, AFTER = 3, 5, 2, [0, 10]
Played = dict[int, list[Filmed]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return Run.create(tmp_path_factory.mktemp("film") / "run", tiny_maesn(), tiny_settings())


@pytest.fixture(scope="module")
def played(run: Run) -> Played:
    learner = run.learner.fast_learner(run.latest_state())
    world = run.world(run.task_set("test"), "sparse")
    asked = Evaluation(episodes=2 * PLAYED, episodes_per_update=PLAYED, seed=4)
    return record_adaptation(learner, world, asked, TASK, AFTER, PLAYED)


def test_the_episodes_are_those_of_adapt(run: Run, played: Played, tmp_path: Path) -> None:
    asked = Evaluation(episodes=2 * PLAYED, episodes_per_update=PLAYED, seed=4)
    curves = maesn.adapt(run, asked, out=tmp_path / "table.csv").curves
    for before, episodes in played.items():
        column = TASK, before // PLAYED
        returns = [episode.total_return for episode in episodes]
        np.testing.assert_allclose(np.mean(returns), curves.mean_return[column], rtol=1e-5)
        solved = [episode.solved for episode in episodes]
        np.testing.assert_allclose(np.mean(solved), curves.success_rate[column], rtol=1e-6)
    assert list(played) == AFTER


def test_a_search_is_shown_one_latent_after_the_other(run: Run, tmp_path: Path) -> None:
    asked = Evaluation(rule=own_searches.BestOf(), episodes=5, deploy_episodes=0, seed=4)
    with new_tasks(run, asked) as (world, learner):
        played = record_adaptation(learner, world, asked, TASK, [0, 2], 3)
    curves = maesn.adapt(run, asked, out=tmp_path / "table.csv").curves
    shown = [episode.total_return for before in (0, 2) for episode in played[before]]
    wanted = np.asarray(curves.mean_return[TASK])[[0, 1, 2, 2, 3, 4]]
    np.testing.assert_allclose(shown, wanted, rtol=1e-5)


def test_the_states_belong_to_the_returns(run: Run, played: Played) -> None:
    goal = np.asarray(run.task_set("test")[TASK])
    for episodes in played.values():
        qpos = np.stack([episode.states["qpos"] for episode in episodes], axis=1)
        assert qpos.shape == (41, PLAYED, 2)
        distance = np.linalg.norm(qpos[1:] - goal, axis=-1)
        goal_part = np.where(distance > 0.5, -np.linalg.norm(goal), -distance).sum(0)
        # A step of u moves the point by 0.1 u, and costs 0.05 u^2.
        cost = 0.05 * np.sum((np.diff(qpos, axis=0) / 0.1) ** 2, axis=(0, 2))
        returns = [episode.total_return for episode in episodes]
        np.testing.assert_allclose(returns, goal_part - cost, rtol=1e-4)
        solved = [episode.solved for episode in episodes]
        np.testing.assert_array_equal(solved, (distance <= 0.5).any(0))


class Drawn:
    """Stands for `Scene`, so that what is drawn can be seen where nothing can be drawn."""

    def __init__(self, env: Point, view: Any, width: int, height: int) -> None:
        self.view, self.shape = view, (height, width, 3)
        self.calls: list[tuple[np.ndarray, np.ndarray]] = []
        scenes.append(self)

    def draw(self, readings: Any, task: np.ndarray, trail: np.ndarray) -> np.ndarray:
        self.calls.append((readings["qpos"], trail))
        return np.full(self.shape, len(self.calls) % 200, np.uint8)

    def close(self) -> None:
        pass


scenes: list[Drawn] = []


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Drawn]:
    scenes.clear()
    monkeypatch.setattr(film, "Scene", Drawn)
    return scenes


def test_an_episode_is_drawn_state_by_state_with_its_way(
    played: Played, drawn: list[Drawn], run: Run
) -> None:
    shown = {before: episodes[:SHOWN] for before, episodes in played.items()}
    made = film.draw(Point(), run.task_set("test")[TASK], shown, 15)
    assert list(made) == AFTER
    assert [len(one.pictures) for one in made[0]] == [4] * SHOWN  # steps 0, 15, 30 and 40
    episodes = [episode for kept in shown.values() for episode in kept]
    states = np.stack([episode.states["qpos"] for episode in episodes], axis=1)
    assert len(drawn[0].calls) == 4 * 2 * SHOWN
    for index, (qpos, trail) in enumerate(drawn[0].calls):
        episode, picture = divmod(index, 4)
        now = [0, 15, 30, 40][picture]
        np.testing.assert_array_equal(qpos, states[now, episode])
        way = [0, 15, 30, 40][: picture + 1]
        np.testing.assert_allclose(trail, states[way, episode], rtol=1e-6)
    lower, upper = drawn[0].view
    # Start and goal region are seen; who goes astray leaves the picture.
    goal = np.asarray(run.task_set("test")[TASK])
    seen = np.concatenate(
        [states[:1, 0], [goal - Point().sparse_radius, goal + Point().sparse_radius]]
    )
    assert (seen.min(0) >= np.array(lower) - 1e-6).all()
    assert (seen.max(0) <= np.array(upper) + 1e-6).all()


def test_an_episode_that_ended_stands_still_where_it_was_sound(
    run: Run, drawn: list[Drawn], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two episodes end after 8 and 7 steps; the first one because its state blew up."""
    play, readings = Collector.play, {}

    def cut(self: Collector, *arguments: Any) -> Any:
        episodes, whole = play(self, *arguments)
        readings["qpos"] = np.array(whole["qpos"])
        readings["qpos"][8:] = np.nan
        lengths = np.array([8, 7, *[7] * (PLAYED - 2)])
        valid = np.arange(episodes.valid.shape[-1]) < lengths[:, None]
        return replace(episodes, valid=jnp.asarray(valid[None])), {**whole, **readings}

    monkeypatch.setattr(Collector, "play", cut)
    asked = Evaluation(episodes=0, episodes_per_update=PLAYED)
    with new_tasks(run, asked) as (world, learner):
        ended = record_adaptation(learner, world, asked, TASK, [0], SHOWN)
    assert [len(one.states["qpos"]) for one in ended[0]] == [8, 8]
    film.draw(Point(), run.task_set("test")[TASK], ended, 5)
    for index, (qpos, trail) in enumerate(drawn[0].calls):
        episode, picture = divmod(index, 9)
        np.testing.assert_array_equal(qpos, readings["qpos"][min(5 * picture, 7), episode])
        assert np.isfinite(trail).all()


def test_the_files_can_be_read(run: Run, drawn: list[Drawn], tmp_path: Path) -> None:
    asked = Evaluation(episodes=2 * PLAYED, episodes_per_update=PLAYED)
    written = maesn.render(
        run, asked, task=TASK, after=(2 * PLAYED, 0), shown=SHOWN, out=tmp_path / "new" / "pictures"
    )
    names = [f"test-sparse-with-10-episodes-5-per-update-task-3{end}" for end in (".gif", ".png")]
    assert written == [tmp_path / "new" / "pictures" / name for name in names]
    with Image.open(written[0]) as moving, Image.open(written[1]) as still:
        assert moving.n_frames == 41
        assert moving.info["loop"] == 0
        assert moving.size == still.size
        assert still.size == (SHOWN * 340, 2 * 310)
        # It begins with the last states, up to its palette: this is seen where nothing moves.
        end, last = (np.asarray(picture.convert("RGB"), float) for picture in (still, moving))
        moving.seek(1)
        start = np.asarray(moving.convert("RGB"), float)
        assert np.abs(last - end).mean() < 0.5 * np.abs(start - end).mean()


def test_episodes_have_the_names_that_tables_count_by() -> None:
    """Of trials an update is one episode, and side by side stand different trials."""
    played = {before: [Filmed({}, float(k), solved=False, pictures=[]) for k in range(3)]
              for before in (0, 4)}  # fmt: skip
    alone = film.with_names(played, 2, are_trials=False)
    assert [*alone] == ["before adaptation", "after learning from 4 episodes"]
    assert [name for name, _ in [*alone.values()][1]] == ["episode 5", "episode 6", "episode 7"]
    trials = film.with_names(played, 2, are_trials=True)
    assert [*trials] == ["before adaptation", "after learning from 2 episodes"]
    names = [name for name, _ in [*trials.values()][1]]
    assert names == ["trial 1,\nepisode 3", "trial 2,\nepisode 3", "trial 1,\nepisode 4"]


@pytest.fixture
def painting(tmp_path: Path) -> Run:
    return Run.create(tmp_path / "painting", tiny_maesn(), tiny_settings(), family=painters)


def painters_task(*, paints: bool) -> int:
    goals = painters.task_set("test").tasks[:, 0]
    return int(np.flatnonzero((goals >= 0) == paints)[0])


def test_what_draws_itself_is_filmed_by_its_own_pictures(painting: Run, tmp_path: Path) -> None:
    task = painters_task(paints=True)
    asked = Evaluation(episodes=8, episodes_per_update=4, num_threads=2)
    with new_tasks(painting, asked) as (world, learner):
        assert world.film(3, 4, (30, 40))
        played = record_adaptation(learner, world, asked, task, [0, 8], 3)
    for episode in (episode for episodes in played.values() for episode in episodes[:3]):
        clock = np.rint(HORIZON * episode.states["observation"][:, 0]).astype(int)
        assert [picture.shape for picture in episode.pictures] == [(40, 30, 3)] * 3
        # Bars at the left and the right: the paintings are half as wide as they are high.
        assert [picture[20, 0, 0] for picture in episode.pictures] == [255] * 3
        seen = [min(time, len(clock) - 1) for time in (0, 4, 6)]
        assert [picture[20, 15, 0] for picture in episode.pictures] == (10 * clock[seen]).tolist()
    options = {"task": task, "after": (0,), "shown": 2, "family": painters, "out": tmp_path}
    gif, _ = maesn.render(painting, asked, **options)
    _, _, end, ends = painters.task_set("test").tasks[task]
    with Image.open(gif) as moving:  # which leaves out what repeats the picture before
        assert moving.n_frames == (int(end) + 2 if ends else HORIZON + 1)


def test_what_is_no_picture_is_refused(painting: Run, tmp_path: Path) -> None:
    asked = Evaluation(episodes=4, episodes_per_update=4, num_threads=2)
    task = painters_task(paints=False)
    with pytest.raises(EpisodeError, match=r"`render` must return a picture, .* got NoneType"):
        maesn.render(painting, asked, task=task, family=painters, out=tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--task", "100"], "`task` must"),
        (["--after", "75"], "`after` must"),
        (["--shown", "51"], "`shown` must"),
    ],
)
def test_mistakes_get_a_sentence(
    arguments: list[str], message: str, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["render", str(run.directory), *arguments]) == cli.USAGE_ERROR
    assert message in capsys.readouterr().err


def test_without_a_library_to_draw_with_nothing_is_played(
    run: Run, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "off")
    monkeypatch.setattr(film, "record_adaptation", None)  # playing would fail
    assert cli.run(["render", str(run.directory)]) == cli.USAGE_ERROR
    assert capsys.readouterr().err.startswith("maesn render: pictures need a library")


def test_the_command_draws_or_says_what_to_install(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["render", str(run.directory), "--task", "3", "--after", "0", "--shown", "1"]
    options = ["--episodes", "5", "--episodes-per-update", "5", "--out", str(tmp_path)]
    code, printed = cli.run([*command, *options]), capsys.readouterr()
    if not can_draw():
        assert code == cli.USAGE_ERROR
        assert_says_what_to_install(printed.err)
        return
    assert code == 0, printed.err
    (written,) = tmp_path.glob("test-sparse-*-task-3.png")
    with Image.open(written) as sheet:
        colours = len(np.unique(np.asarray(sheet).reshape(-1, 3), axis=0))
    assert colours > 300
    assert printed.out.split() == [str(path) for path in sorted(tmp_path.iterdir())]


def test_what_has_no_place_in_a_plane_is_refused_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    learner = tiny_maesn(policy=maesn.CategoricalMLP((8,)))
    family = "bernoulli_bandit:bandit"
    blind = Run.create(tmp_path / "run", learner, tiny_settings(family=family))
    words = ["render", str(blind.directory), "--family", family]
    assert cli.run(words) == cli.USAGE_ERROR
    assert "`bandit` cannot be drawn" in capsys.readouterr().err
