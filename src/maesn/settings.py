"""How settings are checked, and how they are named: where they are nested, or misspelt."""

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Any, get_args

LARGEST_COUNT = 2**31 - 1  # of JAX's integers


def leaves(settings: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return the values in nested settings by their path, as in `outer.trust_region.damping`."""
    found: dict[str, Any] = {}
    for name, value in settings.items():
        inner = isinstance(value, Mapping)
        found |= leaves(value, f"{path}{name}.") if inner else {path + name: value}
    return found


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return the question whether another word is meant, with a space before it; else nothing."""
    near = difflib.get_close_matches(word, known, n=1)
    return f" Did you mean `{near[0]}`?" if near else ""


def in_files(name: str) -> str:
    """Return a name as files and directories have it: without a colon."""
    return name.replace(":", "-")


def check_choice(name: str, value: str, choices: Any) -> None:
    """Refuse by ValueError what is not in a `Literal`: misspelt, it would count as another one.

    The choices may be a tuple as well.
    """
    choices = choices if isinstance(choices, tuple) else get_args(choices)
    if value not in choices:
        known = " or ".join(map(repr, choices))
        raise ValueError(f"`{name}` must be {known}, got {value!r}.")


def check_number(name: str, value: int | float | None, least: int, most: int | None = None) -> None:
    """Refuse by ValueError a number outside of a range; None is never refused.

    Without `most`, counts end at `LARGEST_COUNT`, and other numbers nowhere.
    """
    if value is None:
        return
    largest = most if most is not None else LARGEST_COUNT if isinstance(value, int) else math.inf
    if not least <= value <= largest:
        bound = f"at least {least}" if not value >= least else f"at most {largest}"
        raise ValueError(f"`{name}` must be {bound}, got {value}.")


def check_positive(settings: Any, *names: str) -> None:
    """Refuse by ValueError a setting that is not positive and finite; None is never refused."""
    for name in names:
        value = getattr(settings, name)
        if value is not None and not 0 < value < math.inf:
            raise ValueError(f"`{name}` must be positive and finite, got {value}.")


def check_sizes(settings: Any, *names: str) -> None:
    """Refuse by ValueError widths of layers that are not positive."""
    for name in names:
        if any(size < 1 for size in getattr(settings, name)):
            raise ValueError(f"`{name}` must be positive, got {getattr(settings, name)}.")


def check_least(settings: Any, **least: int) -> None:
    """Refuse by ValueError numbers below their least value; None is never refused."""
    for name, smallest in least.items():
        check_number(name, getattr(settings, name), smallest)


def check_numbers(settings: Any, **least: int) -> None:
    """Check settings by `check_least`, and their `seed` and `sparse_radius`."""
    check_least(settings, **least)
    # JAX would silently take it modulo 2^32.
    check_number("seed", settings.seed, 0, 2**32 - 1)
    check_positive(settings, "sparse_radius")
