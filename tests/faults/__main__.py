"""`python -m faults`: a campaign of faults, and its table."""

import argparse
import logging
import os
import sys
import tempfile
import time
import warnings
from pathlib import Path

# Before JAX is imported: as in tests/conftest.py, and nothing that runs in threads of its own,
# which a forked process lacks.
os.environ |= {
    "JAX_PLATFORMS": "cpu",
    "MPLBACKEND": "Agg",
    "OPENBLAS_NUM_THREADS": "1",
    "JAX_ENABLE_COMPILATION_CACHE": "false",
    "JAX_DISABLE_MOST_OPTIMIZATIONS": "true",
    "XLA_FLAGS": "--xla_cpu_use_fusion_emitters=false --xla_cpu_multi_thread_eigen=false",
}

from faults.kinds import KINDS
from faults.material import Material
from faults.table import campaign, header, line

import maesn


def main() -> int:
    parser = argparse.ArgumentParser(prog="faults", description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of all draws")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the full campaign")
    parser.add_argument("--only", choices=list(KINDS), nargs="+", default=list(KINDS))
    parser.add_argument("--index", type=int, help="one attempt alone, as a finding names it")
    options = parser.parse_args()
    logging.getLogger("maesn").propagate = False
    logging.getLogger("maesn").addHandler(logging.NullHandler())
    warnings.simplefilter("ignore")
    start, wrong = time.monotonic(), []
    with tempfile.TemporaryDirectory() as directory:
        material = Material(Path(directory))
        print(header())
        chosen = [KINDS[name] for name in options.only]
        for kind, found in campaign(chosen, material, options.seed, options.scale, options.index):
            print(line(kind.name, found), flush=True)
            wrong += found.wrong
            sys.stderr.writelines(f"{sentence}\n\n" for sentence in found.wrong)
    minutes, share = (time.monotonic() - start) / 60, f"{options.scale:g} of a full campaign"
    print(f"\nmaesn {maesn.__version__}, seed {options.seed}, {share}, {minutes:.0f} minutes")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
