"""The runtime lives on a robot that has Python and NumPy and nothing else."""

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys

before = set(sys.modules)
for name in ("beartype", "equinox", "jax", "jaxlib", "jaxtyping", "matplotlib", "mujoco", "rich",
             "safetensors", "scipy", "tensorboardX", "tyro"):
    sys.modules[name] = None  # importing it raises ImportError

from maesn.runtime import Explorer, Safeguards

explorer = Explorer.load(sys.argv[1], seed=0, safeguards=Safeguards(max_change=0.1))
for _ in range(3):
    z = explorer.begin_episode()
    explorer.act([0.0, 0.1])
    explorer.end_episode([z[0]])
explorer.begin_episode()
explorer.save(sys.argv[2])
explorer = Explorer.load(sys.argv[2])
explorer.discard()
explorer.adapt()
assert explorer.update == 1
assert abs(explorer.latent_mean).max() > 0

loaded = {name.partition(".")[0] for name, module in sys.modules.items() if module is not None}
print(*sorted(loaded - {name.partition(".")[0] for name in before} - sys.stdlib_module_names))
print(*sorted(name for name in sys.modules if name.startswith("maesn") and "runtime" not in name))
"""


def test_a_whole_life_without_the_library_s_other_dependencies(
    policy: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-c", PROGRAM, str(policy), str(tmp_path / "saved.npz")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    packages, modules = done.stdout.splitlines()
    # NumPy's random numbers are compiled by Cython, which shows as modules of its own.
    assert {name for name in packages.split() if "cython" not in name} == {"maesn", "numpy"}
    assert set(modules.split()) == {"maesn", "maesn._version"}
