"""Meta-reinforcement learning of structured exploration strategies, in JAX.

Every public name has one path, `maesn.<name>`, and is loaded when it is first used: importing this
package imports neither JAX nor MuJoCo, so that `maesn --help` answers at once and
`maesn.runtime` can live on a robot that has NumPy alone.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from maesn._version import __version__ as __version__

if TYPE_CHECKING:  # what a type checker and an editor see; the same names as in the table below
    pass

# Module -> the names that it gives to the public surface. A name must not equal that of a module
# of this package: importing the module would silently put it in the name's place.
_PUBLIC: dict[str, tuple[str, ...]] = {}

_MODULE_OF = {name: module for module, names in _PUBLIC.items() for name in names}


def __getattr__(name: str) -> object:
    """Loads a public name at its first use (PEP 562) and keeps it."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module `maesn` has no attribute `{name}`; see `dir(maesn)`.")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})
