"""Settings that suit a family: what they change, and where the command line uses them."""

import dataclasses
import functools
from typing import Any

import pytest

import maesn
from maesn import api
from maesn.commands.train import train
from maesn.envs import FAMILIES, HOSTED
from maesn.learners import PRESETS, method_name
from maesn.learners.recommended import ANY, RECOMMENDED, recommended_settings
from maesn.runs.config import RunSettings
from maesn.serialization import TAG, fields_to_json, replaced
from maesn.settings import leaves

SUITED = [(method, family) for family in RECOMMENDED for method in RECOMMENDED[family]]


@pytest.mark.parametrize(("method", "family"), SUITED)
def test_what_is_recommended_is_all_that_differs(method: str, family: str) -> None:
    table = recommended_settings(method, family)
    learner, usual = maesn.recommended(method, family), PRESETS[method]()
    of_any = recommended_settings(method, ANY)
    own, others = (leaves(fields_to_json(one)) for one in (learner, usual))
    for path, value in table.items():
        assert own[path] == value
        # A family may take back what is recommended on any.
        assert value != others.get(path) or value != of_any.get(path, value)
    for path in own:
        slots = [one.removesuffix(TAG) for one in table if one.endswith(f".{TAG}")]
        is_listed = path in table or path.startswith(tuple(slots))
        assert is_listed or own[path] == others[path]
    assert method_name(learner) == method


def test_the_file_names_families_methods_and_settings() -> None:
    fields = {field.name for field in dataclasses.fields(RunSettings)}
    assert set(RECOMMENDED) <= {ANY, *FAMILIES, *HOSTED}
    for of_family in RECOMMENDED.values():
        assert set(of_family) <= set(PRESETS)
        assert all(set(one.get("run", {})) <= fields for one in of_family.values())


def test_elsewhere_the_preset_is_what_there_is() -> None:
    assert [method_name(preset()) for preset in PRESETS.values()] == [*PRESETS]
    assert maesn.recommended("maesn", "point") == PRESETS["maesn"]()
    assert maesn.recommended("rl2", "blockpush") == PRESETS["rl2"]()
    with pytest.raises(ValueError, match=r"`method` must be one of maesn.*got 'trpo'"):
        maesn.recommended("trpo", "point")


@pytest.mark.parametrize(
    ("words", "learner", "episodes"),
    [
        ("--family blockpush", maesn.recommended("maesn", "blockpush"), 50),
        ("--family=ant", maesn.recommended("maesn", "ant"), 50),
        ("", maesn.recommended("maesn", "wheeled"), 20),
        ("--family blockpush --settings reference", PRESETS["maesn"](), 20),
        (
            "--episodes-per-task 30 --family wheeled --context.initial-spread 0.5",
            replaced(PRESETS["maesn"](), {"context.initial_spread": 0.5}),
            30,
        ),
    ],
)
def test_the_command_begins_with_what_suits(
    words: str, learner: Any, episodes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []

    @functools.wraps(api.train)
    def keep(learner: Any, settings: RunSettings, *_: Any, **__: Any) -> None:
        found.append((learner, settings.episodes_per_task))

    monkeypatch.setattr(api, "train", keep)
    monkeypatch.setattr("maesn.commands.train.say_what_is_next", lambda run: None)
    train(["maesn", *words.split()])
    assert found == [(learner, episodes)]
