"""One exported policy for all tests of a file."""

from pathlib import Path

import pytest
from runtime.robot import policy_file


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return policy_file(tmp_path_factory.mktemp("policy"))
