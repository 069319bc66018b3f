"""Environments written down: rebuilt whatever today's defaults are, or refused."""

import json
import math
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from carts import MODEL, MOTOR, Cart, CartTask
from strange_families import settable
from strangers import HORIZON

from maesn.envs import FAMILIES, AnyEnv, Point, TaskFamily, Wheeled, find_family, wheeled
from maesn.envs.recorded import describe_env, rebuild_env
from maesn.physics.digest import model_digest


def written(env: AnyEnv) -> dict[str, Any]:
    """What a file says of the environment."""
    return json.loads(json.dumps(describe_env(env), allow_nan=False))


def family_of(make_env: Any) -> TaskFamily:
    """A family of one task that makes such environments."""
    return TaskFamily("own", make_env, lambda stream, size: np.zeros((size, 1)), ("task",), 0)


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_is_rebuilt_as_it_was(name: str) -> None:
    family = find_family(name)
    other = family.make_env().variants[-1]
    for settings in (
        {},
        {"variant": other, "reward_kind": "sparse", "sparse_radius": 0.125, "horizon": 7},
    ):
        env = family.make_env(**settings)
        assert rebuild_env(family, written(env)) == env


def test_changed_defaults_change_nothing_and_overrides_win() -> None:
    old, changed = Point(), partial(Point, sparse_radius=9.0, horizon=3)
    assert rebuild_env(family_of(changed), written(old)) == old
    record = written(wheeled.make_env(sparse_radius=0.5, horizon=7))
    assert {"control_period": 0.01, "frame_skip": 1, "control_cost": 0.05}.items() <= record.items()
    env = rebuild_env(wheeled, record, reward_kind="sparse", sparse_radius=2.0)
    assert env == Wheeled(reward_kind="sparse", sparse_radius=2.0, horizon=7)
    with pytest.raises(ValueError, match="`wheeled` cannot be made as recorded"):
        rebuild_env(wheeled, record, radius=2.0)


def test_a_family_may_choose_its_environment_by_variant() -> None:
    def make(variant: str = "reference", **settings: Any) -> AnyEnv:
        return (Wheeled if variant == "reference" else Point)(variant=variant, **settings)

    for variant in ("reference", "paper"):
        env = make(variant, reward_kind="sparse")
        assert rebuild_env(family_of(make), written(env)) == env


class Gained(Point):
    """A point with more settings and constants than before."""

    wind: float = 0.5
    gain = 2.0


@pytest.mark.parametrize(
    ("now", "then", "changes", "message"),
    [
        (Gained, Point, {}, r"`wind` of `point` is now 0\.5, but was not there"),
        (Point, Gained, {}, r"`wind` of `point` is now gone, but was 0\.5"),
        (Gained, Gained, {"gain": 3.0}, r"`gain` of `point` is now 2\.0, but was 3\.0"),
        (Point, Point, {"horizon": 0}, "`horizon` must be at least 1, got 0"),
        (Point, Point, {"horizon": None}, "`own` cannot be made as recorded"),
    ],
)
def test_what_has_changed_or_cannot_be_is_named(
    now: type, then: type, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        rebuild_env(family_of(now), written(then()) | changes)


def test_a_variant_of_another_size_is_no_override() -> None:
    family = find_family("blockpush")
    with pytest.raises(ValueError, match="`observation_size` of `blockpush` is now 28, but was 26"):
        rebuild_env(family, written(family.make_env()), variant="paper")


class Odd(Point):
    """A point with settings of every kind."""

    limits: tuple[tuple[float, ...], ...] = ((0.0, 1.0), (-math.inf, math.inf))
    weights: Any = None
    scale: Any = abs


def test_settings_of_every_kind() -> None:
    env = Odd(limits=((2.0,), (-1.0, math.nan)), weights=np.arange(3.0))
    record = written(env)
    assert record["limits"] == [[2.0], [-1.0, "nan"]]
    assert "scale" not in record
    other = Odd(limits=((2.0,), (-1.0, math.inf)), weights=np.arange(3.0))
    same = partial(Odd, weights=np.arange(3.0))
    rebuilt: Any = rebuild_env(family_of(same), written(other))
    assert rebuilt.limits == ((2.0,), (-1.0, math.inf))
    with pytest.raises(ValueError, match="`weights` of `point` is now"):
        rebuild_env(family_of(partial(Odd, weights=np.arange(4.0))), record)
    other_type = partial(Odd, weights=jnp.arange(3, dtype=jnp.float32))
    with pytest.raises(ValueError, match="`weights` of `point` is now"):
        rebuild_env(family_of(other_type), record)


def test_a_gymnasium_family_is_rebuilt() -> None:
    env = settable.make_env(reward_kind="sparse")
    record = written(env)
    assert record["horizon"] == HORIZON
    assert record["interface.lower"] == [-1.0, 0.0]
    assert not [name for name in record if name.startswith("recipe")]
    assert rebuild_env(settable, record) == env
    assert rebuild_env(settable, record | {"horizon": 3}).horizon == 3
    with pytest.raises(ValueError, match=r"`interface\.upper` of `stranger` is now \[1\.0, 0\.5\]"):
        rebuild_env(settable, record | {"interface.upper": [1.0, 1.0]})


def cart_family(model_name: str) -> TaskFamily:
    """Carts on that model."""

    class OwnCart(Cart):
        model: ClassVar[str] = model_name

    def draw(stream: np.random.Generator, size: int) -> CartTask:
        return CartTask(np.zeros(size), np.ones(size))

    return TaskFamily("cart", OwnCart, draw, ("speed", "mass"), 0)


def test_a_changed_model_is_noticed() -> None:
    xml = MODEL.format(actuator=MOTOR)
    record = written(cart_family(xml).make_env())
    rewritten = xml.replace("<worldbody>", "<!-- the rail -->\n<worldbody>").replace(
        'size="0.1" mass="1"', 'mass="1"  size="0.1"'
    )
    family = cart_family(rewritten)
    assert rebuild_env(family, record) == family.make_env()
    with pytest.raises(ValueError, match="`model_digest` of `cart` is now"):
        rebuild_env(cart_family(xml.replace('mass="1"', 'mass="2"')), record)


def test_files_that_a_model_names_belong_to_it(tmp_path: Path) -> None:
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    cart = '<mujoco><compiler meshdir="meshes"/><include file="body.xml"/></mujoco>'
    (tmp_path / "cart.xml").write_text(cart)
    (tmp_path / "body.xml").write_text('<mujoco><asset><mesh file="hull.stl"/></asset></mujoco>')
    (meshes / "hull.stl").write_bytes(b"round")
    digests = [model_digest(tmp_path / "cart.xml")]
    for file, content in (
        ("meshes/hull.stl", "square"),
        ("body.xml", '<mujoco><asset><mesh file="hull.stl" scale="2 2 2"/></asset></mujoco>'),
        ("cart.xml", cart.replace("<include", '<option timestep="1"/><include')),
    ):
        (tmp_path / file).write_text(content)
        digests.append(model_digest(tmp_path / "cart.xml"))
    assert len(set(digests)) == 4
    with pytest.raises(FileNotFoundError, match="`model` must be one of"):
        model_digest(tmp_path / "nothing.xml")
