"""Several devices and processes that share the tasks of a meta-batch.

Task slots are cut into blocks, one per device. Whatever has a row per task lives where its tasks
are; parameters are the same on all devices. What depends on all tasks is a sum, a mean or a
collection over the mesh, and these are the only communication. Inside of a function that
`over_tasks` runs, `total`, `mean` and `gather` communicate; anywhere else, and without a mesh, they
return what they are given.

A gradient must not be taken through them: differentiate a device's own part, then add up.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float, Int

from maesn.numerics.returns import masked_mean

Tree = TypeVar("Tree")
Function = Callable[[Any, Any], tuple[Any, Any]]

AXIS = "task"
_WHOLE = PartitionSpec()  # type: ignore[no-untyped-call]
_CUT = PartitionSpec(AXIS)  # type: ignore[no-untyped-call]

_mesh: ContextVar[Mesh | None] = ContextVar("mesh", default=None)


@contextlib.contextmanager
def sharing_tasks(devices: Sequence[jax.Device]) -> Iterator[None]:
    """Let these devices share the tasks of every meta-batch, until the block ends.

    Args:
        devices: of all processes, the same number of each.
    """
    ordered = sorted(devices, key=lambda device: (device.process_index, device.id))
    token = _mesh.set(Mesh(np.array(ordered), (AXIS,)) if len(ordered) > 1 else None)
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
    """Return how many devices share the tasks, those of all processes."""
    mesh = _mesh.get()
    return 1 if mesh is None else mesh.size


def own_slots(rows: Tree) -> Tree:
    """Return the rows of the task slots that this process plays, of the rows of all slots."""
    mesh = _mesh.get()
    if mesh is None or not mesh.is_multi_process:
        return rows
    first = mesh.local_devices[0]
    position = mesh.devices.tolist().index(first)

    def cut(x: Array) -> Array:
        share = x.shape[0] // mesh.size
        return x[position * share : (position + len(mesh.local_devices)) * share]

    return jax.tree.map(cut, rows)


def over_tasks(function: Function, shared: Any, rows: Any) -> tuple[Any, Any]:
    """Call a compiled function of all tasks, on all devices that share them.

    Args:
        function: of `shared` and `rows`; returns such a pair again. What it returns as shared must
            be the same on all devices. A method of a module, or a function of a module's file: it
            is compiled once for each.
        shared: a pytree that all tasks share, with the same values in all processes.
        rows: a pytree with a row for each task slot of this process.

    Returns:
        What the function returns, with the rows of the task slots of this process.
    """
    mesh = _mesh.get()
    if mesh is None:
        outcome: tuple[Any, Any] = _call(function, shared, rows)
        return outcome
    placed = _placed(mesh, shared, _WHOLE), _placed(mesh, rows, _CUT)
    common, own = _call_sharded(mesh, function, *placed)
    return jax.tree.map(_own_copy, common), jax.tree.map(_own_rows, own)


@eqx.filter_jit
def _call(function: Function, shared: Any, rows: Any) -> tuple[Any, Any]:
    return function(shared, rows)


@eqx.filter_jit
def _call_sharded(mesh: Mesh, function: Function, shared: Any, rows: Any) -> tuple[Any, Any]:
    arrays, constants = eqx.partition((shared, rows), eqx.is_array)

    def local(*varied: Any) -> tuple[Any, Any]:
        return function(*eqx.combine(varied, constants))

    # Not `check_vma=True`: loops that begin with a constant would all have to say that it varies.
    run = jax.shard_map(
        local, mesh=mesh, in_specs=(_WHOLE, _CUT), out_specs=(_WHOLE, _CUT), check_vma=False
    )
    outcome: tuple[Any, Any] = run(*arrays)
    return outcome


def _placed(mesh: Mesh, tree: Any, spec: PartitionSpec) -> Any:
    """Return the arrays of this process as arrays of the mesh, whole or cut."""
    sharding, devices = NamedSharding(mesh, spec), mesh.local_devices

    def place(x: Any) -> Any:
        if not eqx.is_array(x):
            return x
        pieces, shape = [x] * len(devices), x.shape
        if spec == _CUT:
            size = x.shape[0] // len(devices)
            pieces = [x[i * size : (i + 1) * size] for i in range(len(devices))]
            shape = (size * mesh.size, *x.shape[1:])
        pieces = [jax.device_put(piece, one) for piece, one in zip(pieces, devices, strict=True)]
        return jax.make_array_from_single_device_arrays(shape, sharding, pieces)

    return jax.tree.map(place, tree)


def _own_rows(x: Array) -> Array:
    """Return the rows of this process, on its first device."""
    shards = sorted(x.addressable_shards, key=lambda shard: shard.index[0].start or 0)
    return jnp.asarray(np.concatenate([np.asarray(shard.data) for shard in shards]))


def _own_copy(x: Array) -> Array:
    # By way of NumPy, here and above: an array that is bound to its device would have programs
    # compiled again that have been compiled for one that is not.
    return jnp.asarray(np.asarray(x.addressable_data(0)))


def _is_inside() -> bool:
    """Whether a function is being compiled for the mesh."""
    return AXIS in jax.sharding.get_abstract_mesh().manual_axes


def num_shards() -> int:
    """Return how many devices the function is for that is being compiled."""
    return jax.lax.axis_size(AXIS) if _is_inside() else 1


def total(tree: Tree) -> Tree:
    """Return the sum over all devices."""
    if not _is_inside():
        return tree
    summed: Tree = jax.lax.psum(tree, AXIS)  # type: ignore[no-untyped-call]
    return summed


def mean(tree: Tree) -> Tree:
    """Return the mean over all devices, which hold equally many tasks."""
    if not _is_inside():
        return tree
    averaged: Tree = jax.lax.pmean(tree, AXIS)  # type: ignore[no-untyped-call]
    return averaged


def gather(tree: Tree) -> Tree:
    """Return the rows of all devices, in the order of their task slots."""
    if not _is_inside():
        return tree
    gathered: Tree = jax.lax.all_gather(tree, AXIS, tiled=True)
    return gathered


def share(tree: Tree, rows: Int[Array, " row"]) -> Tree:
    """Return this device's share of some rows; without a mesh, all of them.

    On a mesh every device takes an equal number of them. Where that does not divide evenly the
    last parts are filled up with rows of zeros, in which no step is valid.

    Args:
        tree: arrays with a row for each sample of all devices.
        rows: which samples.
    """
    if not _is_inside():
        return jax.tree.map(lambda x: x[rows], tree)
    devices = num_shards()
    samples = jax.tree.leaves(tree)[0].shape[0]
    size = -(-rows.shape[0] // devices)
    filled = jnp.full(size * devices, samples).at[: rows.shape[0]].set(rows)
    own = jax.lax.dynamic_slice(filled, (jax.lax.axis_index(AXIS) * size,), (size,))
    return jax.tree.map(lambda x: x.at[own].get(mode="fill", fill_value=0), tree)


def part_of_mean(values: Float[Array, "*shape"], valid: Bool[Array, "*shape"]) -> Float[Array, ""]:
    """Return this device's part of the mean of the valid elements of all devices.

    The parts add up to the mean: it is the `total` of them. Without a mesh it is `masked_mean`.
    """
    if not _is_inside():
        return masked_mean(values, valid)
    count = total(jnp.sum(valid, dtype=values.dtype))
    return jnp.sum(jnp.where(valid, values, 0.0)) / jnp.maximum(count, 1.0)


def mean_of_valid(values: Float[Array, "*shape"], valid: Bool[Array, "*shape"]) -> Float[Array, ""]:
    """Return the mean of the valid elements of all devices."""
    return total(part_of_mean(values, valid))
