"""Devices share tasks. Programs of their own, because JAX counts its devices only once."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent


def output_of(script: str, *arguments: str) -> str:
    command = [sys.executable, str(FOLDER / script), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_sums_means_and_shares_of_devices_are_those_of_all_rows() -> None:
    said = output_of("primitives.py")
    assert said == (
        "`meta_batch_size` is 20, which 3 devices cannot share evenly: take 1, 2, 4, 5, 10 or 20 "
        "of them.\n"
    )


@pytest.mark.long
@pytest.mark.parametrize("method", ["maesn", "latent_space", "maml"])
def test_five_iterations_do_not_depend_on_the_number_of_devices(method: str) -> None:
    found = json.loads(output_of("agreement.py", method, "point", "5"))
    assert set(found) == {"2", "4"}
    for deviations in found.values():
        assert max(deviations.values()) < 1e-4, deviations


@pytest.mark.long
@pytest.mark.parametrize("family", ["wheeled", "ant"])
def test_an_outer_step_on_the_same_episodes_does_not_depend_on_it(family: str) -> None:
    found = json.loads(output_of("agreement.py", "maesn", family, "1", "same"))
    for deviations in found.values():
        assert max(deviations.values()) < 1e-5, deviations
