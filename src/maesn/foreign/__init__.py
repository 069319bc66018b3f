"""Environments that others wrote, in processes of their own.

Only this package and `maesn.gym` use Gymnasium. Nothing here imports JAX: a worker is up in the
time that its environments take to import.
"""

from importlib.util import find_spec

if find_spec("gymnasium") is None:
    raise ImportError("foreign environments need Gymnasium: pip install -e '.[gym]' in its clone")

from maesn.foreign.interface import Interface as Interface
from maesn.foreign.interface import InterfaceError as InterfaceError
from maesn.foreign.pool import Readings as Readings
from maesn.foreign.pool import WorkerError as WorkerError
from maesn.foreign.pool import WorkerPool as WorkerPool
