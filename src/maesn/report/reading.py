"""Files that may be absent or wrong, or cannot be written: what came, and what to do.

Nothing here executes what it reads.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from maesn.storage import RunError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name what cannot be written inside the block.

    Raises:
        RunError: it cannot.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise RunError(f"Cannot write `{path}` ({reason}): choose another `--out`.") from error


def take_array(
    arrays: Mapping[str, np.ndarray], name: str, shape: Sequence[int | str], path: Path, remedy: str
) -> np.ndarray:
    """Return one array in double precision, after checking its shape.

    Args:
        arrays: as `read_arrays` returns them.
        name: which one.
        shape: a number where the size is fixed, the name of the axis where it is free.
        path: where the arrays are from, for the message.
        remedy: what the user should do if it is wrong.

    Raises:
        RunError: if the array is absent, not numeric or of another shape.
    """
    expected = f"`{name}` [{', '.join(map(str, shape))}]"
    if name not in arrays:
        present = ", ".join(sorted(arrays)) or "no arrays"
        raise RunError(f"Expected {expected} in `{path}`, got {present}; {remedy}.")
    array = arrays[name]
    fits = array.ndim == len(shape) and all(
        size == wanted or isinstance(wanted, str)
        for size, wanted in zip(array.shape, shape, strict=False)
    )
    if not fits or array.dtype.kind not in "fiu" or 0 in array.shape:
        got = f"{array.dtype} {list(array.shape)}"
        raise RunError(f"Expected {expected} in `{path}`, got {got}; {remedy}.")
    return array.astype(np.float64)
