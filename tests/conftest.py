"""Arithmetic in the tests is stricter than in production: no silent promotion or broadcasting.

Shapes and types are checked as well: `--jaxtyping-packages` in `pyproject.toml` wraps every
annotated function of the package. Warnings are errors.
"""

import contextlib
import ctypes
import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

# Before JAX is imported, and inherited by the programs that tests start. A graphics card can be
# asked for by name (`JAX_PLATFORMS=cuda make test`); figures never open a window.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ["MPLBACKEND"] = "Agg"
# Threads of NumPy's linear algebra would wait for each other longer than they compute.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
# Tests compile far more than they compute. Compiling takes half as long without optimisations, and
# half of that without XLA's fusion emitters. What is compiled runs slower: production keeps both.
# One module for the code generator instead of 32, and no stack of calls with every operation, save
# a few percent more.
os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "true"
os.environ["JAX_TRACEBACK_IN_LOCATIONS_LIMIT"] = "0"
os.environ["XLA_FLAGS"] = " ".join(
    [
        os.environ.get("XLA_FLAGS", ""),
        "--xla_cpu_use_fusion_emitters=false",
        "--xla_cpu_parallel_codegen_split_count=1",
    ]
)
# XLA has aborted the process while it read back a program that the tests had stored.
os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"

import jax
import jaxtyping
import pytest

# The process that hands out tests needs no Matplotlib.
if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Bytes of a worker: what lets it forget its compiled programs, and what it may take in all.
FULL = 1_200_000_000
WORKER_MEMORY = 2_000_000_000

# Tests interrupt themselves, which what a shell runs in the background would ignore.
signal.signal(signal.SIGINT, signal.default_int_handler)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture
def x64() -> Iterator[None]:
    """Double precision for one test, where the truth that it compares with needs it.

    Off otherwise: production is single precision, and so is what most tests must judge.
    """
    with jax.enable_x64(True):
        yield


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the tests that fork: the larger a process has become, the more a copy costs."""
    items.sort(key=lambda item: item.path.name != "test_faults.py")


def pytest_collection_finish() -> None:
    """Spare the garbage collector the hundreds of thousands of objects that modules made."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """Start one process per core, but no more than the machine's free memory can hold."""
    found = Path("/proc/meminfo")
    if not found.exists():
        return None
    fields = dict(line.split(":") for line in found.read_text().splitlines())
    available = 1024 * int(fields["MemAvailable"].split()[0])
    for group in ("memory.max", "memory/memory.limit_in_bytes"):  # a container's own limit
        with contextlib.suppress(OSError, ValueError):
            available = min(available, int((Path("/sys/fs/cgroup") / group).read_text()))
    return max(1, min(len(os.sched_getaffinity(0)), available // WORKER_MEMORY))


@pytest.fixture(scope="module", autouse=True)
def forget_compiled_programs() -> Iterator[None]:
    """Let compiled programs go when they take much memory.

    Until then, the files that follow use them again. The C library keeps what is freed in small
    pieces, and gives it back when it is asked.
    """
    yield
    statm = Path("/proc/self/statm")
    if not statm.exists():
        return
    if int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") > FULL:
        jax.clear_caches()
        gc.collect()
        with contextlib.suppress(AttributeError):  # other C libraries than glibc
            ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture
def figures_unsaved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write an empty file for each figure instead of laying it out, which takes a second.

    For tests of what is drawn when; `tests/reporting` looks at the pictures.
    """

    def touch(figure: "Figure", directory: Path, name: str) -> list[Path]:
        assert figure.axes
        directory.mkdir(parents=True, exist_ok=True)
        files = [directory / f"{name}.{suffix}" for suffix in ("png", "pdf")]
        for file in files:
            file.touch()
        return files

    monkeypatch.setattr("maesn.reporting.report.save_figure", touch)
    monkeypatch.setattr("maesn.reporting.page.rendered", lambda *_: b"<svg/>")  # its charts


@pytest.fixture
def no_type_checks() -> Iterator[None]:
    """Call functions as users do: a value of the wrong type gets the library's own message."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture
def optimising_compiler(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Compile as in production, also in programs that the test starts.

    For tests that compute longer than they compile.
    """
    monkeypatch.setenv("JAX_DISABLE_MOST_OPTIMIZATIONS", "false")
    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", True)
