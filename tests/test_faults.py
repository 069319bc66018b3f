"""A small draw of the campaign of faults (`make test-faults`), of every kind."""

import logging
from collections.abc import Iterator

import jax
import pytest
from faults.kinds import KINDS
from faults.material import Material
from faults.table import WRONG, campaign

SEED = 18
ATTEMPTS = {
    "kills": 10,
    "mutated files": 120,
    "disks": 10,
    "runtime calls": 8,
}


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Material]:
    """Made with programs that run in one thread: others are not there in a process that forked."""
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    yield Material(tmp_path_factory.mktemp("faults"))
    jax.config.update("jax_cpu_enable_async_dispatch", True)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", KINDS)
def test_nothing_is_lost(material: Material, name: str, caplog: pytest.LogCaptureFixture) -> None:
    kind = KINDS[name]
    with caplog.at_level(logging.WARNING):
        ((_, found),) = campaign([kind], material, SEED, ATTEMPTS[name] / kind.number)
    assert not found.wrong, "\n\n".join(found.wrong)
    assert not any(found.counts[outcome] for outcome in WRONG)
    assert found.counts.total() >= ATTEMPTS[name]
