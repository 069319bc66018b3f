"""What two workers gain over one in a study of eight jobs.

    python benchmarks/scaling.py --iterations 22

Every worker has one thread, XLA's included.
"""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Settings:
    """What is timed."""

    iterations: int = 30
    """Meta-iterations of each job; enough of them for a minute."""
    family: str = "wheeled"
    """Family of tasks."""


def main(settings: Settings) -> None:
    """Print how long a study of eight jobs takes one worker and two."""
    text = (
        f'family = "{settings.family}"\n[runs.maesn]\nseeds = [0, 1, 2, 3, 4, 5, 6, 7]\n'
        f"iterations = {settings.iterations}\n"
    )
    seconds = {}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "eight.toml"
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(Path(folder) / "cache")}
        # The first one fills the compilation cache.
        for name, iterations, workers in (("warm", 1, 1), ("one", 0, 1), ("two", 0, 2)):
            changed = text if not iterations else text.replace(f"= {settings.iterations}", "= 1")
            file.write_text(changed)
            begin = time.perf_counter()
            options = ["--out", str(Path(folder) / name), "--workers", str(workers)]
            command = [sys.executable, "-m", "maesn", "study", "run", str(file), *options]
            subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
            seconds[name] = time.perf_counter() - begin
    print(f"eight jobs of {settings.iterations} meta-iterations on {settings.family}")
    print(f"one worker {seconds['one']:.1f} s, two workers {seconds['two']:.1f} s")
    print(f"speed-up: {seconds['one'] / seconds['two']:.2f}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
