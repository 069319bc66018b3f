"""How settings are checked."""

from typing import Any, get_args

LARGEST_COUNT = 2**31 - 1  # of JAX's integers


def check_choice(name: str, value: str, choices: Any) -> None:
    """Refuse what is not among the choices: misspelt, it would silently count as another one.

    Args:
        name: of the setting.
        value: what it was given.
        choices: a `Literal`.

    Raises:
        ValueError: it is not one of them.
    """
    if value not in get_args(choices):
        known = " or ".join(map(repr, get_args(choices)))
        raise ValueError(f"`{name}` must be {known}, got {value!r}.")


def check_numbers(settings: Any, **least: int) -> None:
    """Refuse numbers below their `least` or too large, and a radius of no length.

    The settings have a `seed` and a `sparse_radius`. None is never refused, all else by ValueError.
    """
    for name, smallest in {"seed": 0, **least}.items():
        value = getattr(settings, name)
        if value is not None and value < smallest:
            raise ValueError(f"`{name}` must be at least {smallest}, got {value}.")
        if value is not None and name != "seed" and value > LARGEST_COUNT:
            raise ValueError(f"`{name}` must be at most {LARGEST_COUNT}, got {value}.")
    if settings.seed >= 2**32:  # JAX would silently take it modulo 2^32
        raise ValueError(f"`seed` must be below 2^32, got {settings.seed}.")
    if settings.sparse_radius is not None and not settings.sparse_radius > 0:
        raise ValueError(f"`sparse_radius` must be positive, got {settings.sparse_radius}.")
