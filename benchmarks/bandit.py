"""RL2 on Bernoulli bandits, beside the optimum and the classics.

    PYTHONPATH=examples python benchmarks/bandit.py --out results/bandit

Five arms give 1 with a probability of their own, uniform on [0, 1], and there are ten pulls (Duan
et al. 2016, section 3.1). What any algorithm can win on average is known: dynamic programming over
the counts of rewards gives the Bayes-optimal return. UCB1, Thompson sampling, and random pulls are
simulated here; the paper's numbers stand beside.

Training takes some minutes on two cores, `--load` evaluates an earlier policy.
"""

import argparse
import functools
import time
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from bernoulli_bandit import Bandit, bandit
from safetensors.numpy import load_file, save_file

from maesn import ProximalStep, RecurrentMetaLearner, RecurrentValue
from maesn.envs import TaskSet
from maesn.evaluation.adapting import adapt
from maesn.evaluation.evaluation import Evaluation
from maesn.experience.episodes import Collect
from maesn.learners import Problem
from maesn.learners.trial_meta import RecurrentFastLearner
from maesn.numerics import MinibatchDescent
from maesn.policies import Recurrent, RecurrentPolicy
from maesn.runs.checkpoint import named_leaves, restore
from maesn.worlds import make_world
from maesn.worlds.collector import Collector

ARMS, PULLS = 5, 10
TRAINING_TASKS = 50_000
TEST_TASKS = 20_000
PAPER = {"UCB1": 6.7, "Thompson": 5.7, "random": 5.0, "RL2": 6.7, "Gittins index": 6.6}
POLICY = "policy.safetensors"

# Chooses an arm in every simulation from its counts of rewards and failures.
Choose = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]


def bayes_optimal_return(arms: int, pulls: int) -> float:
    """Return the largest expected number of rewards, by dynamic programming.

    The posterior of an arm is Beta(a + 1, b + 1) after a rewards and b failures, so it gives 1 next
    with probability (a + 1) / (a + b + 2). Arms are exchangeable: states are sorted.
    """

    @functools.cache
    def value(counts: tuple[tuple[int, int], ...], left: int) -> float:
        if left == 0:
            return 0.0
        return max(pull(counts, arm, left) for arm in range(arms))

    def pull(counts: tuple[tuple[int, int], ...], arm: int, left: int) -> float:
        won, failed = counts[arm]
        probability = (won + 1) / (won + failed + 2)
        others = counts[:arm] + counts[arm + 1 :]
        win = value(tuple(sorted((*others, (won + 1, failed)))), left - 1)
        loss = value(tuple(sorted((*others, (won, failed + 1)))), left - 1)
        return probability * (1.0 + win) + (1.0 - probability) * loss

    return value(((0, 0),) * arms, pulls)


def ucb1(won: np.ndarray, failed: np.ndarray, stream: np.random.Generator) -> np.ndarray:
    """Upper confidence bounds (Auer et al. 2002), mean + c sqrt(2 log t / n) with c = 0.2.

    Every arm starts with one reward and one failure, the uniform prior, and is not tried first:
    with ten pulls there is no time for it. Duan et al. tuned c as well, to 0.2.
    """
    counts = won + failed + 2
    time_so_far = 1 + (won + failed).sum(1, keepdims=True)
    bound = (won + 1) / counts + 0.2 * np.sqrt(2 * np.log(time_so_far) / counts)
    return (bound + 1e-9 * stream.uniform(size=bound.shape)).argmax(1)  # ties are broken at random


def thompson(won: np.ndarray, failed: np.ndarray, stream: np.random.Generator) -> np.ndarray:
    """Thompson sampling from the Beta posteriors."""
    return stream.beta(won + 1, failed + 1).argmax(1)


def randomly(won: np.ndarray, failed: np.ndarray, stream: np.random.Generator) -> np.ndarray:
    """Any arm."""
    return stream.integers(0, won.shape[1], len(won))


def simulate(choose: Choose, arms: int, pulls: int, runs: int = 200_000) -> tuple[float, float]:
    """Return mean number of rewards and its standard error."""
    stream = np.random.default_rng(0)
    probability, rows = stream.uniform(size=(runs, arms)), np.arange(runs)
    won, failed = np.zeros((runs, arms)), np.zeros((runs, arms))
    for _ in range(pulls):
        arm = choose(won, failed, stream)
        rewards = stream.uniform(size=runs) < probability[rows, arm]
        won[rows, arm] += rewards
        failed[rows, arm] += ~rewards
    total = won.sum(1)
    return float(total.mean()), float(total.std() / np.sqrt(runs))


def make_learner(meta_batch_size: int = 2000) -> RecurrentMetaLearner:
    """Return RL2 for bandits: one episode is a trial, and rewards are few and near."""
    descent = MinibatchDescent(learning_rate=1e-3, epochs=4, minibatches=4)
    return RecurrentMetaLearner(
        policy=Recurrent(action_kind="discrete", readout_sizes=(64,)),
        policy_step=ProximalStep(entropy_weight=0.0, descent=descent),
        value=RecurrentValue(readout_sizes=(64,), descent=descent),
        meta_batch_size=meta_batch_size,
        trial_episodes=1,
        # Duan et al., appendix A, for bandits: 0.99 and 0.3.
        discount=0.99,
        gae_lambda=0.3,
    )


def make_collect(tasks: TaskSet, env: Bandit) -> Collect:
    """Return what plays one trial of each task."""
    return Collector(make_world(env, tasks), 1)


def train(
    learner: RecurrentMetaLearner, collect: Collect, env: Bandit, iterations: int
) -> RecurrentPolicy:
    """Return the policy after that many meta-iterations."""
    key = jax.random.key(0)
    state = learner.init(key, Problem(env.observation_size, env.action_size, collect.num_tasks))
    start = time.perf_counter()
    for iteration in range(iterations):
        state, info = learner.step(jax.random.fold_in(key, iteration), state, collect)
        if iteration % 25 == 24:
            told = f"return {float(info.return_after):.3f}, entropy {float(info.entropy):.2f}"
            print(
                f"{iteration + 1}/{iterations}: {told}, {time.perf_counter() - start:.0f} s",
                flush=True,
            )
    return state.policy


def evaluate(policy: RecurrentPolicy, collect: Collect) -> tuple[float, float]:
    """Return mean number of rewards in new tasks, one trial each, and its standard error."""
    asked = Evaluation(episodes=0, tasks_at_once=2000)
    outcome = adapt(RecurrentFastLearner(policy, 1), collect, asked)
    returns = outcome.curves.mean_return[:, 0]
    return float(returns.mean()), float(returns.std() / np.sqrt(len(returns)))


def save_policy(path: Path, policy: RecurrentPolicy) -> None:
    """Write the weights, by name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file({name: np.asarray(leaf) for name, leaf in named_leaves(policy).items()}, path)


def load_policy(path: Path) -> RecurrentPolicy:
    """Read the weights that `save_policy` has written."""
    env = Bandit()
    shapes = eqx.filter_eval_shape(
        make_learner().policy.init, jax.random.key(0), env.observation_size, env.action_size, 0
    )
    return restore(shapes, load_file(path), path)


def table(rl2: tuple[float, float]) -> str:
    """Return the mean rewards of all algorithms, as a table in Markdown."""
    rows = {
        name: simulate(choose, ARMS, PULLS)
        for name, choose in (("random", randomly), ("Thompson", thompson), ("UCB1", ucb1))
    }
    rows["RL2"] = rl2
    lines = ["| algorithm | mean return | standard error | Duan et al. |", "|---|---|---|---|"]
    for name, (mean, error) in rows.items():
        lines.append(f"| {name} | {mean:.3f} | {error:.3f} | {PAPER[name]} |")
    optimum = bayes_optimal_return(ARMS, PULLS)
    lines.append(
        f"| Bayes-optimal | {optimum:.3f} | exact | Gittins index {PAPER['Gittins index']} |"
    )
    return "\n".join(lines)


def main() -> None:
    """Train, evaluate, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--load", type=Path, help="evaluate this policy instead of training one")
    parser.add_argument("--out", type=Path, help="directory for table and policy")
    options = parser.parse_args()
    env = Bandit()
    if options.load is None:
        tasks = bandit.task_set("training", TRAINING_TASKS)
        policy = train(make_learner(), make_collect(tasks, env), env, options.iterations)
    else:
        policy = load_policy(options.load)
    text = table(evaluate(policy, make_collect(bandit.task_set("test", TEST_TASKS), env)))
    print(text)
    if options.out is not None:
        save_policy(options.out / POLICY, policy)
        (options.out / "table.md").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
