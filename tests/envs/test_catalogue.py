"""Families are found by name, and a wrong name is answered helpfully."""

from typing import Any

import pytest

from maesn.envs import FAMILIES, AnyEnv, find_family, point


def test_a_family_is_found_by_its_name() -> None:
    assert list(FAMILIES) == [
        *("point", "wheeled", "ant", "blockpush"),
        *("sparse_point", "grid_navi"),
        *("cheetah_vel", "cheetah_dir", "cheetah_body"),
        *("ant_dir", "ant_goal", "sparse_ant_goal"),
    ]
    for name, family in FAMILIES.items():
        assert find_family(name) is family
        assert family.name == family.make_env().name == name


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_takes_the_same_settings(name: str) -> None:
    default = find_family(name).make_env()
    settings = {"variant": default.variants[-1], "reward_kind": "sparse", "sparse_radius": 0.125}
    env: AnyEnv = find_family(name).make_env(**settings)
    assert {setting: getattr(env, setting) for setting in settings} == settings
    assert (default.variant, default.reward_kind) == (default.variants[0], "dense")
    assert find_family(name).make_env(variant="reference") == default
    # A compiled program has the environment as a constant: equal ones must share it.
    assert env == find_family(name).make_env(**settings)
    assert hash(env) == hash(find_family(name).make_env(**settings))
    assert env != default


@pytest.mark.parametrize("name", FAMILIES)
def test_settings_without_a_meaning_are_refused(name: str) -> None:
    for setting, wrong, least in (("horizon", 0, 1), ("sparse_radius", -0.5, 0)):
        with pytest.raises(ValueError, match=f"`{setting}` must be at least {least}, got {wrong}"):
            find_family(name).make_env(**{setting: wrong})


@pytest.mark.usefixtures("no_type_checks")
@pytest.mark.parametrize("wrong", [{"reward_kind": "dens"}, {"variant": "papier"}])
def test_a_misspelt_kind_of_reward_does_not_count_as_the_other_one(wrong: dict[str, Any]) -> None:
    (name,) = wrong
    with pytest.raises(ValueError, match=f"`{name}` must be '.*' or '.*', got '{wrong[name]}'"):
        point.make_env(**wrong)
