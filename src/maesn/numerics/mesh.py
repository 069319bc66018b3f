"""Share the tasks of a meta-batch among several devices.

Task slots are cut into blocks, one per device. Arrays with a row per task are sharded by these
blocks; parameters are replicated. `total`, `mean` and `gather` are the only communication. They
communicate inside of a function that `over_tasks` runs; anywhere else, and without a mesh, they
return their argument.

Do not differentiate through them: differentiate a device's own part, then add up.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float

Tree = TypeVar("Tree")
Function = Callable[[Any, Any], tuple[Any, Any]]

AXIS = "task"
_REPLICATED = PartitionSpec()  # type: ignore[no-untyped-call]
_SHARDED = PartitionSpec(AXIS)  # type: ignore[no-untyped-call]

_mesh: ContextVar[Mesh | None] = ContextVar("mesh", default=None)


@contextlib.contextmanager
def sharing_tasks(devices: Sequence[jax.Device]) -> Iterator[None]:
    """Let these devices share the tasks of every meta-batch, until the block ends."""
    token = _mesh.set(Mesh(np.array(devices), (AXIS,)) if len(devices) > 1 else None)
    try:
        yield
    finally:
        _mesh.reset(token)


def check_split(meta_batch_size: int) -> None:
    """Refuse a meta-batch that cannot be cut into equal parts.

    Raises:
        ValueError: the number of devices does not divide the number of tasks.
    """
    mesh = _mesh.get()
    if mesh is None or meta_batch_size % mesh.size == 0:
        return
    divisors = [n for n in range(1, meta_batch_size + 1) if meta_batch_size % n == 0]
    raise ValueError(
        f"`meta_batch_size` is {meta_batch_size}, which {mesh.size} devices cannot share evenly: "
        f"take {', '.join(map(str, divisors[:-1]))} or {divisors[-1]} of them."
    )


def num_devices() -> int:
    """Return the number of devices that share the tasks."""
    mesh = _mesh.get()
    return 1 if mesh is None else mesh.size


def refuse_sharing() -> None:
    """Refuse by ValueError several devices for a method that learns on one."""
    if num_devices() > 1:
        raise ValueError(
            f"this method learns on one device, got `devices` {num_devices()}: leave it out."
        )


def over_tasks(function: Function, shared: Any, rows: Any) -> tuple[Any, Any]:
    """Compile a function and call it on all devices that share the tasks.

    Args:
        function: maps (shared, rows) to another such pair. Its first result must be the same on all
            devices. Give a function of a file or a method of an `eqx.Module`: a lambda would be
            compiled again at every call.
        shared: a pytree that all tasks share.
        rows: a pytree with a row for each task slot.

    Returns:
        The pair that the function returns.
    """
    mesh = _mesh.get()
    if mesh is None:
        outcome: tuple[Any, Any] = _call(function, shared, rows)
        return outcome
    placed = _placed(mesh, shared, _REPLICATED), _placed(mesh, rows, _SHARDED)
    outcome = _call_sharded(mesh, function, *placed)
    # By way of NumPy: an array committed to a device would make JAX compile again the programs that
    # it has compiled for uncommitted arrays.
    found: tuple[Any, Any] = jax.tree.map(lambda x: jnp.asarray(np.asarray(x)), outcome)
    return found


@eqx.filter_jit
def _call(function: Function, shared: Any, rows: Any) -> tuple[Any, Any]:
    return function(shared, rows)


@eqx.filter_jit
def _call_sharded(mesh: Mesh, function: Function, shared: Any, rows: Any) -> tuple[Any, Any]:
    arrays, constants = eqx.partition((shared, rows), eqx.is_array)

    def on_one_device(*own_arrays: Any) -> tuple[Any, Any]:
        return function(*eqx.combine(own_arrays, constants))

    # With `check_vma=True` each loop that starts from a constant would need a `jax.lax.pcast`.
    specs = (_REPLICATED, _SHARDED)
    run = jax.shard_map(on_one_device, mesh=mesh, in_specs=specs, out_specs=specs, check_vma=False)
    outcome: tuple[Any, Any] = run(*arrays)
    return outcome


def _placed(mesh: Mesh, tree: Any, spec: PartitionSpec) -> Any:
    """Return a tree with its arrays on the mesh, replicated or sharded."""
    sharding = NamedSharding(mesh, spec)
    return jax.tree.map(lambda x: jax.device_put(x, sharding) if eqx.is_array(x) else x, tree)


def _is_inside() -> bool:
    """Whether JAX is tracing a function for the mesh."""
    return AXIS in jax.sharding.get_abstract_mesh().manual_axes


def num_shards() -> int:
    """Return the number of devices that the function being traced runs on."""
    return jax.lax.axis_size(AXIS) if _is_inside() else 1


def total(tree: Tree) -> Tree:
    """Return the sum over all devices."""
    return _exchanged(jax.lax.psum, tree)


def mean(tree: Tree) -> Tree:
    """Return the mean over all devices, which hold equally many tasks."""
    return _exchanged(jax.lax.pmean, tree)


def gather(tree: Tree) -> Tree:
    """Return the rows of all devices, in the order of their task slots."""
    return _exchanged(partial(jax.lax.all_gather, tiled=True), tree)


def _exchanged(communicate: Callable[[Tree, str], Tree], tree: Tree) -> Tree:
    """Return what the devices make of a tree together; outside of their program, the tree."""
    return communicate(tree, AXIS) if _is_inside() else tree


def mean_of_valid(values: Float[Array, "*shape"], valid: Bool[Array, "*shape"]) -> Float[Array, ""]:
    """Return the mean of the valid elements of all devices."""
    count = total(jnp.sum(valid, dtype=values.dtype))
    return total(jnp.sum(jnp.where(valid, values, 0.0)) / jnp.maximum(count, 1.0))
