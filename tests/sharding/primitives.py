"""What devices tell each other, against the same sums over all rows on one device."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maesn.numerics import devices, mesh
from maesn.numerics.normalization import ObservationStatistics, no_observations

TASKS = 8


def everything(shared: Any, rows: Any) -> tuple[Any, Any]:
    """All ways to communicate, in one program."""
    values, valid, observation = rows
    return (
        mesh.total(values.sum(0)),
        mesh.mean(values.mean()),
        mesh.gather(values),
        mesh.mean_of_valid(values, valid),
        mesh.total(jax.value_and_grad(lambda x: (values * x[None]).sum())(shared)),
        no_observations(3).with_batch(observation, valid),
        mesh.total(jnp.ones(())),
    ), (observation * 2.0, values[:, :0])


def main() -> None:
    stream = np.random.default_rng(0)
    values = jnp.asarray(stream.normal(size=(TASKS, 6)))
    valid = jnp.asarray(stream.random((TASKS, 6)) < 0.7)
    observation = jnp.asarray(stream.normal(size=(TASKS, 6, 3)))
    shared = jnp.arange(6.0)
    rows = values, valid, observation
    alone = mesh.over_tasks(everything, shared, rows)
    (total, mean, gathered, valid_mean, _, statistics, _), _ = alone
    np.testing.assert_allclose(total, values.sum(0))
    np.testing.assert_allclose(mean, values.mean())
    np.testing.assert_array_equal(gathered, values)
    np.testing.assert_allclose(valid_mean, np.asarray(values)[np.asarray(valid)].mean())
    assert isinstance(statistics, ObservationStatistics)
    for number in (2, 4):
        with mesh.sharing_tasks(jax.devices()[:number]):
            assert mesh.num_devices() == number
            shared_by_several = mesh.over_tasks(everything, shared, rows)
            mesh.check_split(TASKS)
        (*found, count), cut = shared_by_several
        assert count == number
        (*wanted, _), whole = alone
        jax.tree.map(
            lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12),
            (found, cut),
            (wanted, whole),
        )
        assert {x.device for x in jax.tree.leaves(cut)} == {jax.devices()[0]}
    devices.num_cores = lambda: 3
    for tasks, asked, expected in (
        (20, None, 2),
        (9, None, 3),
        (1, None, 1),
        (20, 1, 1),
        (20, 4, 4),
    ):
        with devices.sharing(asked, tasks):
            assert mesh.num_devices() == expected
    with mesh.sharing_tasks(jax.devices()[:3]):
        try:
            mesh.check_split(20)
        except ValueError as error:
            print(error)


if __name__ == "__main__":
    jax.config.update("jax_num_cpu_devices", 4)
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_numpy_dtype_promotion", "strict")
    jax.config.update("jax_numpy_rank_promotion", "raise")
    main()
