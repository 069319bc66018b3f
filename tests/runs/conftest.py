"""A run directory of `maesn`, untrained."""

import shutil
from pathlib import Path

import pytest
from small_runs import create_tiny


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run directory that tests copy instead of making their own."""
    return create_tiny(tmp_path_factory.mktemp("runs") / "run").directory


@pytest.fixture
def directory(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / "run")
