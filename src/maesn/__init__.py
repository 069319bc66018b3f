"""Meta-reinforcement learning of structured exploration strategies, in JAX.

Every public name has one path, `maesn.<name>`, and is loaded when it is first used: importing this
package imports neither JAX nor MuJoCo, so that `maesn --help` answers at once and
`maesn.runtime` can live on a robot that has NumPy alone.
"""

import ast
from importlib import import_module
from pathlib import Path

from maesn._version import __version__ as __version__

# Public name -> its module, as `__init__.pyi` says, which type checkers and editors read as well.
# A name must not equal that of a module of this package: importing the module would silently put it
# in the name's place.
_MODULE_OF = {
    alias.name: str(statement.module)
    for statement in ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8")).body
    if isinstance(statement, ast.ImportFrom)
    for alias in statement.names
}


def __getattr__(name: str) -> object:
    """Loads a public name at its first use (PEP 562) and keeps it."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module `maesn` has no attribute `{name}`; see `dir(maesn)`.")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})
