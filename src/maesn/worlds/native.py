"""Worlds moved by the MuJoCo engine on the host."""

from functools import partial
from typing import Any

import jax
import numpy as np

from maesn.axes import HostReadings
from maesn.envs.base import AbstractMujocoEnv, Start
from maesn.envs.tasks import TaskSet
from maesn.physics import AbstractSimulator, PhysicsError
from maesn.worlds.base import (
    AbstractWorld,
    Act,
    Actors,
    Decision,
    SimulationFailure,
    Trajectory,
)
from maesn.worlds.host import play_on_host
from maesn.worlds.simulators import native_simulator


class NativeWorld(AbstractWorld):
    """Plays an `AbstractMujocoEnv` on a pool of threads.

    Simulators are kept open, one for each number of simulations that was asked for.
    """

    env: AbstractMujocoEnv[Any]

    def __init__(self, env: AbstractMujocoEnv[Any], tasks: TaskSet, num_threads: int = 0) -> None:
        self.env = env
        self.tasks = tasks
        self._num_threads = num_threads
        self._simulators: dict[int, AbstractSimulator] = {}

    def play(self, act: Act, actors: Actors, start: Start) -> Trajectory:
        """Play with an `act` that the caller has compiled."""
        simulator = self._simulator(start.qpos.shape[0])
        return play_on_host(
            self.env,
            act,
            actors,
            first=_reset(simulator, start),
            advance=partial(_advance, simulator),
        )

    def close(self) -> None:
        for simulator in self._simulators.values():
            simulator.close()
        self._simulators = {}

    def _simulator(self, num_simulations: int) -> AbstractSimulator:
        if num_simulations not in self._simulators:
            self._simulators[num_simulations] = native_simulator(
                self.env, num_simulations, self._num_threads
            )
        return self._simulators[num_simulations]


def _reset(simulator: AbstractSimulator, start: Start) -> HostReadings:
    try:
        return simulator.reset(*jax.tree.map(np.asarray, tuple(start)))
    except PhysicsError as error:
        raise SimulationFailure(error.simulations[0], 0, error.reason) from error


def _advance(simulator: AbstractSimulator, decision: Decision, step: int) -> HostReadings:
    control, ended = np.asarray(decision.control), np.asarray(decision.ended)
    try:
        return simulator.step(control, abandoned=ended.ravel())
    except PhysicsError as error:
        raise SimulationFailure(error.simulations[0], step, error.reason) from error
