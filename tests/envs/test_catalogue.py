"""Families are found by name, and a wrong name is answered helpfully."""

from typing import Any

import pytest

from maesn.envs import FAMILIES, AnyEnv, find_family, point


def test_names_are_unique_and_complete() -> None:
    assert list(FAMILIES) == ["point", "wheeled", "ant", "blockpush"]
    assert all(family.name == name for name, family in FAMILIES.items())


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_is_found_by_its_name(name: str) -> None:
    assert find_family(name) is FAMILIES[name]
    assert find_family(name).make_env().name == name


@pytest.mark.parametrize(("wrong", "meant"), [("weeled", "wheeled"), ("Point", "point")])
def test_a_near_miss_is_answered_by_a_suggestion(wrong: str, meant: str) -> None:
    with pytest.raises(ValueError, match=f"got `{wrong}`. Did you mean `{meant}`\\?") as error:
        find_family(wrong)
    assert all(name in str(error.value) for name in FAMILIES)


def test_a_name_like_no_other_gets_the_list_alone() -> None:
    with pytest.raises(ValueError, match="`family` must be one of point, wheeled") as error:
        find_family("xyzzy")
    assert "Did you mean" not in str(error.value)
    assert all(name in str(error.value) for name in FAMILIES)


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_takes_the_same_settings(name: str) -> None:
    settings = {"variant": "paper", "reward_kind": "sparse", "sparse_radius": 0.125}
    env: AnyEnv = find_family(name).make_env(**settings)
    assert {setting: getattr(env, setting) for setting in settings} == settings
    default = find_family(name).make_env()
    assert (default.variant, default.reward_kind) == ("reference", "dense")
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
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"reward_kind": "dens"}, "`reward_kind` must be 'dense' or 'sparse', got 'dens'."),
        ({"variant": "papier"}, "`variant` must be 'reference' or 'paper', got 'papier'."),
    ],
)
def test_a_misspelt_kind_of_reward_does_not_count_as_the_other_one(
    wrong: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        point.make_env(**wrong)
