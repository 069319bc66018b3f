"""Compiled programs: where they are kept between processes, and what they cost."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

import jax
import jax.monitoring

# Moves the compilation cache; empty, 0 or off: no cache.
CACHE_VARIABLE = "MAESN_CACHE"

_durations: list[float] = []  # of the compilations of this process, in seconds


def cache_directory(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return where compiled programs are kept; None if the user wants no cache."""
    chosen = environment.get(CACHE_VARIABLE)
    if chosen is not None:
        return None if chosen in ("", "0", "off") else Path(chosen)
    home = Path(environment.get("HOME", "~")).expanduser()
    usual = home / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    return Path(environment.get("XDG_CACHE_HOME") or usual) / "maesn"


def enable_compilation_cache() -> None:
    """Keep compiled programs on disk, so that the next process starts at once."""
    settings = {
        "jax_compilation_cache_dir": str(cache_directory()),
        # Most programs of the first iteration compile in less than the second of JAX's default.
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": 0,
    }
    for name, value in settings.items() if cache_directory() else ():
        jax.config.update(name, value)  # type: ignore[no-untyped-call]


def _listen(event: str, duration_secs: float, **_: str | int) -> None:
    # The time that XLA takes; tracing in Python is not in it.
    if event == "/jax/core/compile/backend_compile_duration":
        _durations.append(duration_secs)


# Once for the process: the older JAX versions have no public way to take a listener back.
jax.monitoring.register_event_duration_secs_listener(_listen)


def compile_seconds() -> float:
    """Return how long XLA has compiled in this process so far."""
    return sum(_durations)
