"""The loop that plays episodes whose world is moved outside of JAX.

A host callback inside a scan would hide the loop from Python: exceptions would arrive as dumps of
the compiler, Ctrl-C would not work, and the compiled program could not be cached.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from maesn.axes import HostReadings, RecurrentState
from maesn.envs.base import AnyEnv
from maesn.worlds.base import Act, Actors, Decision, Moment, Trajectory


def play_on_host(
    env: AnyEnv,
    act: Act,
    actors: Actors,
    first: HostReadings,
    advance: Callable[[Decision, int], HostReadings],
) -> Trajectory:
    """Play one episode of `env.horizon` steps in every simulation, around one compiled decision.

    Args:
        env: the environment.
        act: decides each step; compiled by the caller.
        actors: the agents of all episodes.
        first: readings of the initial states.
        advance: applies the decision of a step to all simulations, and returns their readings.
    """
    record = _Record(first, env.horizon)
    batch = actors.z.shape[:2]
    previous_action: Array | np.ndarray = np.zeros((*batch, env.action_size), np.float32)
    ended: Array | np.ndarray = np.zeros(batch, bool)
    recurrent_state = actors.trial_state.recurrent_state
    for step in range(env.horizon):
        decision = act(
            actors,
            Moment(
                step=np.asarray(step, np.int32),
                readings=record.at(step),
                previous_readings=record.at(max(step - 1, 0)),
                previous_action=previous_action,
                recurrent_state=recurrent_state,
                ended=ended,
            ),
        )
        record.add(step, advance(_without_ended(decision), step), decision)
        previous_action, ended = decision.action, decision.ended
        recurrent_state = decision.recurrent_state
    return record.trajectory(recurrent_state)


def _without_ended(decision: Decision) -> Decision:
    """Set the controls of episodes that have ended to 0: they may be NaN."""
    ended = np.asarray(decision.ended).reshape(-1, 1)
    if not ended.any():
        return decision
    return decision._replace(control=np.where(ended, 0.0, np.asarray(decision.control)))


class _Record:
    """Collects the steps of a batch in arrays of single precision."""

    def __init__(self, first: HostReadings, horizon: int) -> None:
        self._readings = {
            name: np.empty((horizon + 1, *value.shape), np.float32) for name, value in first.items()
        }
        self._decisions: list[Any] = []
        self._write(0, first)

    def _write(self, index: int, readings: HostReadings) -> None:
        # What blew up may be finite in double precision and infinite in single.
        with np.errstate(over="ignore"):
            for name, value in readings.items():
                self._readings[name][index] = value

    def at(self, index: int) -> HostReadings:
        """The readings of one state, as the policy sees them."""
        return {name: values[index] for name, values in self._readings.items()}

    def add(self, step: int, readings: HostReadings, decision: Decision) -> None:
        self._write(step + 1, readings)
        self._decisions.append((decision.action, decision.behaviour))

    def trajectory(self, recurrent_state: RecurrentState) -> Trajectory:
        action, behaviour = jax.tree.map(
            lambda *steps: np.stack([np.asarray(step) for step in steps]), *self._decisions
        )
        return Trajectory(self._readings, action, behaviour, recurrent_state)
