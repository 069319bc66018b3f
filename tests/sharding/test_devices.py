"""How many devices share the tasks, and that a run goes on with another number of them."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from maesn.numerics.devices import num_cores, request_devices, sharing
from maesn.storage import RunError, read_json_lines

SETTINGS = [
    *("--family", "point", "--meta-batch-size", "8", "--episodes-per-task", "5"),
    *("--num-threads", "1", "--outer.trust-region.cg-steps", "5"),
]


@pytest.mark.parametrize(("limit", "cores"), [("1", 1), ("0", 1), ("many", None), ("", None)])
def test_cores_are_at_least_one_and_at_most_the_limit_if_it_is_a_number(
    monkeypatch: pytest.MonkeyPatch, limit: str, cores: int | None
) -> None:
    monkeypatch.delenv("NPROC", raising=False)
    found = num_cores()
    monkeypatch.setenv("NPROC", limit)
    assert num_cores() == (cores or found)


@pytest.mark.long
def test_a_run_goes_on_with_another_number_of_devices(tmp_path: Path) -> None:
    def maesn(*arguments: str) -> None:
        command = [sys.executable, "-m", "maesn", *arguments]
        subprocess.run(command, cwd=tmp_path, env=os.environ | {"JAX_ENABLE_X64": "1"}, check=True)

    train = ("train", "maesn", *SETTINGS, "--iterations", "3", "--run")
    maesn(*train, "one")
    maesn(*train, "two", "--devices", "2")
    maesn("resume", "one", "--iterations", "5", "--devices", "2")
    maesn("resume", "two", "--iterations", "5")
    first, second = (read_json_lines(tmp_path / name / "metrics.jsonl") for name in ("one", "two"))
    for one, two in zip(first, second, strict=True):
        np.testing.assert_allclose(list(one.values()), list(two.values()), rtol=1e-4)
    for name, expected in (("one", [1, 1, 1, 2, 2]), ("two", [2, 2, 2, 1, 1])):
        lines = read_json_lines(tmp_path / name / "timing.jsonl")
        assert [line["devices"] for line in lines] == expected


def test_no_devices_are_refused_and_more_than_jax_has() -> None:
    with pytest.raises(RunError, match="`devices` must be at least 1, got 0"):
        request_devices(0)
    jax.devices()
    with (
        pytest.raises(RunError, match="`devices` is 64, but JAX has begun with"),
        sharing(64, 1),
    ):
        pass
