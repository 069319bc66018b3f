"""How settings are checked."""

from typing import Any, get_args


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
