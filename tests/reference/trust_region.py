"""The outer step: numerical derivatives, conjugate gradients, backtracking."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reference.maesn import Settings, TaskData, adapted, loss, mean_kl
from reference.parameters import Array, Parameters, flatten, unflatten
from reference.policy import action_log_std, action_mean

# Width of the complex step. Nothing is subtracted, so nothing is lost by taking it tiny.
WIDTH = 1e-30


@dataclass(frozen=True)
class TrustRegionSettings:
    max_kl: float = 0.01
    cg_steps: int = 10
    damping: float = 1e-5
    backtrack_ratio: float = 0.8
    max_backtracks: int = 15


@dataclass(frozen=True)
class Outcome:
    """What one outer step did."""

    parameters: Parameters
    accepted: bool
    backtracks: int
    loss_before: float
    loss_after: float
    kl: float


def jacobian(function: Callable[[Array], Array], x: Array) -> Array:
    """Return d function_i / d x_j by complex steps, Im f(x + ih e_j) / h, one parameter at a time.

    Exact up to rounding for analytic functions (Squire and Trapp, "Using complex variables to
    estimate derivatives of real functions", 1998). Conjugate gradients would magnify the error of
    real differences; `test_reference.py` compares with those.
    """
    columns = []
    for j in range(len(x)):
        step = np.zeros(len(x), dtype=complex)
        step[j] = 1j * WIDTH
        columns.append(np.imag(function(x + step)) / WIDTH)
    return np.stack(columns, axis=-1)


def loss_gradient(parameters: Parameters, tasks: list[TaskData], settings: Settings) -> Array:
    """Return the gradient of the meta-loss, flat."""
    return jacobian(lambda x: loss(unflatten(x, parameters), tasks, settings), flatten(parameters))


def kl_gradient(parameters: Parameters, tasks: list[TaskData], settings: Settings) -> Array:
    """Return the gradient of the mean KL divergence, flat."""
    return jacobian(
        lambda x: mean_kl(unflatten(x, parameters), tasks, settings), flatten(parameters)
    )


def curvature(
    parameters: Parameters, tasks: list[TaskData], settings: Settings, every: slice = slice(None)
) -> Array:
    """Return J'FJ, the Hessian of the mean KL divergence at the parameters that played.

    J is the Jacobian of (mean, log std) of every action distribution, and their Fisher information
    is diagonal: 1/variance for a mean, 2 for a log std.

    Args:
        parameters: where.
        tasks: the meta-batch.
        settings: of the inner update.
        every: which steps of each episode to average over.
    """

    def coordinates(x: Array, task: TaskData) -> Array:
        """Mean and log std at every step, `[2, step, action]`."""
        agent = adapted(unflatten(x, parameters), task, settings)
        means = [
            action_mean(agent.theta, episode.observation, agent.draw(episode.noise))[every]
            for episode in task.post.episodes
        ]
        mean = np.concatenate(means)
        return np.stack([mean, np.broadcast_to(action_log_std(agent.theta), mean.shape)])

    flat = flatten(parameters)
    total = np.zeros((len(flat), len(flat)))
    for task in tasks:
        slopes = jacobian(lambda x, task=task: coordinates(x, task), flat)
        _, log_std = coordinates(flat, task)
        fisher = np.stack([np.exp(-2 * log_std), np.full_like(log_std, 2.0)])
        steps = log_std.shape[0]
        total += np.einsum("cdap,cda,cdaq->pq", slopes, fisher, slopes) / steps
    return total / len(tasks)


def conjugate_gradient(matrix: Array, target: Array, steps: int) -> Array:
    """Return the solution of matrix x = target after that many steps, started at 0."""
    solution, residual, direction = np.zeros_like(target), target.copy(), target.copy()
    for _ in range(steps):
        squared = residual @ residual
        if squared < 1e-10:
            break
        image = matrix @ direction
        length = squared / (direction @ image)
        solution = solution + length * direction
        residual = residual - length * image
        direction = residual + (residual @ residual) / squared * direction
    return solution


def outer_step(
    parameters: Parameters, tasks: list[TaskData], settings: Settings, region: TrustRegionSettings
) -> Outcome:
    """Do one step: the longest candidate that lowers the loss within the trust region."""
    flat = flatten(parameters)
    before = loss(parameters, tasks, settings)
    matrix = curvature(parameters, tasks, settings) + region.damping * np.eye(len(flat))
    slope = loss_gradient(parameters, tasks, settings)
    direction = conjugate_gradient(matrix, -slope, region.cg_steps)
    longest = np.sqrt(2 * region.max_kl / (direction @ matrix @ direction + 1e-8)) * direction
    for backtracks in range(region.max_backtracks):
        candidate = unflatten(flat + region.backtrack_ratio**backtracks * longest, parameters)
        after, kl = loss(candidate, tasks, settings), mean_kl(candidate, tasks, settings)
        if after < before and kl < region.max_kl:
            return Outcome(candidate, True, backtracks, before, after, kl)
    return Outcome(parameters, False, region.max_backtracks - 1, before, before, 0.0)
