"""What a study has left for its readers, to be compared byte for byte."""

import re
from pathlib import Path

from maesn.reporting.sources import MANIFEST


def files(directory: Path) -> dict[str, bytes]:
    """Return all files by name; the manifest without the seconds of trainings, which vary."""
    found = {
        str(path.relative_to(directory)): path.read_bytes()
        for path in sorted(directory.rglob("*"))
        if path.is_file()
    }
    if MANIFEST in found:
        found[MANIFEST] = re.sub(rb'"\w+_seconds": [\d.]+', b"", found[MANIFEST])
    return found
