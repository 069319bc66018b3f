"""Environments that others wrote, in processes of their own.

Nothing here imports JAX or Gymnasium: a worker is up in the time that its environments take to
import, and may run in another interpreter.
"""

from maesn.foreign.interface import Interface as Interface
from maesn.foreign.interface import InterfaceError as InterfaceError
from maesn.foreign.pool import Readings as Readings
from maesn.foreign.pool import WorkerPool as WorkerPool
from maesn.foreign.pool import hosted_in as hosted_in
from maesn.foreign.pool import pack_task as pack_task
from maesn.foreign.process import WorkerError as WorkerError
