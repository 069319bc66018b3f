"""Worlds moved by the MuJoCo engine on the host: a Python loop around one compiled decision.

A host callback inside a scan would hide the loop from Python: exceptions would arrive as dumps of
the compiler, Ctrl-C would not work, and the compiled program could not be cached.
"""

from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from maesn.axes import Carry, HostReadings
from maesn.envs.base import AbstractMujocoEnv
from maesn.envs.tasks import TaskSet
from maesn.physics import AbstractSimulator, NativeSimulator, PhysicsError
from maesn.worlds.base import (
    AbstractWorld,
    Act,
    Actors,
    Decision,
    Moment,
    SimulationFailure,
    Start,
    Trajectory,
)


class NativeWorld(AbstractWorld):
    """Plays an `AbstractMujocoEnv` on a pool of threads.

    Simulators are kept open, one for each number of simulations that was asked for.
    """

    def __init__(self, env: AbstractMujocoEnv[Any], tasks: TaskSet, num_threads: int = 0) -> None:
        self._env = env
        self._tasks = tasks
        self._num_threads = num_threads
        self._simulators: dict[int, AbstractSimulator] = {}

    @property
    def env(self) -> AbstractMujocoEnv[Any]:
        return self._env

    @property
    def tasks(self) -> TaskSet:
        return self._tasks

    def play(self, act: Act, actors: Actors, start: Start, carry: Carry) -> Trajectory:
        """See `AbstractWorld.play`. `act` must be compiled by the caller."""
        simulator = self._simulator(start.qpos.shape[0])
        readings = _reset(simulator, start)
        record = _Record(readings, self.env.horizon)
        no_action = np.zeros((*actors.context.shape[:2], self.env.action_size), np.float32)
        previous_action: Array | np.ndarray = no_action
        for step in range(self.env.horizon):
            decision = act(
                actors,
                Moment(
                    step=np.asarray(step, np.int32),
                    readings=record.at(step),
                    previous_readings=record.at(max(step - 1, 0)),
                    previous_action=previous_action,
                    carry=carry,
                ),
            )
            readings = _advance(simulator, np.asarray(decision.control), step)
            record.add(step, readings, decision)
            previous_action, carry = decision.action, decision.carry
        return record.trajectory(carry)

    def _simulator(self, num_simulations: int) -> AbstractSimulator:
        if num_simulations not in self._simulators:
            self._simulators[num_simulations] = NativeSimulator(
                self.env.model,
                num_simulations,
                readings=self.env.readings,
                num_threads=self._num_threads,
            )
        return self._simulators[num_simulations]


class _Record:
    """Collects the steps of a batch in arrays of single precision."""

    def __init__(self, first: HostReadings, horizon: int) -> None:
        self._readings = {
            name: np.empty((horizon + 1, *value.shape), np.float32) for name, value in first.items()
        }
        self._decisions: list[Any] = []
        self._write(0, first)

    def _write(self, index: int, readings: HostReadings) -> None:
        for name, value in readings.items():
            self._readings[name][index] = value

    def at(self, index: int) -> HostReadings:
        """The readings of one state, as the policy sees them."""
        return {name: values[index] for name, values in self._readings.items()}

    def add(self, step: int, readings: HostReadings, decision: Decision) -> None:
        self._write(step + 1, readings)
        self._decisions.append((decision.action, decision.behaviour))

    def trajectory(self, carry: Carry) -> Trajectory:
        action, behaviour = jax.tree.map(
            lambda *steps: np.stack([np.asarray(step) for step in steps]), *self._decisions
        )
        return Trajectory(self._readings, action, behaviour, carry)


def _reset(simulator: AbstractSimulator, start: Start) -> HostReadings:
    try:
        return simulator.reset(*jax.tree.map(np.asarray, tuple(start)))
    except PhysicsError as error:
        raise SimulationFailure(error.simulations[0], 0, error.reason) from error


def _advance(simulator: AbstractSimulator, control: np.ndarray, step: int) -> HostReadings:
    try:
        return simulator.step(control)
    except PhysicsError as error:
        raise SimulationFailure(error.simulations[0], step, error.reason) from error
