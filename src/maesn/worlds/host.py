"""Worlds that are moved outside of JAX: a loop around one compiled decision.

A host callback inside a scan would hide the loop from Python: exceptions would arrive as dumps of
the compiler, Ctrl-C would not work, and the compiled program could not be cached.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, UInt8
from PIL import Image, ImageOps

from maesn.envs.base import AnyEnv
from maesn.envs.tasks import TaskSet
from maesn.foreign import WorkerError
from maesn.physics import PhysicsError
from maesn.storage import RunError
from maesn.worlds.base import (
    AbstractWorld,
    Act,
    Actors,
    Decision,
    Moment,
    SimulationFailure,
    Trajectory,
)
from maesn.worlds.stepping import AbstractStepper, Renderer


class _Camera(NamedTuple):
    """What to film, as `film` was asked."""

    renderer: Renderer
    shown: int
    stride: int
    size: tuple[int, int]


class HostWorld(AbstractWorld):
    """Plays an environment with a stepper.

    Whatever goes wrong, Ctrl-C included, stops the threads and processes of the stepper.
    """

    def __init__(self, env: AnyEnv, tasks: TaskSet, stepper: AbstractStepper) -> None:
        self.env = env
        self.tasks = tasks
        self.stepper = stepper
        self.max_simulations = stepper.max_simulations
        self._camera: _Camera | None = None
        self.pictures: list[list[UInt8[np.ndarray, "height width 3"]]] = []

    def play(self, act: Act, actors: Actors, start: Any) -> Trajectory:
        """Play with an `act` that the caller has compiled."""
        played: list[Decision] = []
        try:
            return self._played(act, actors, start, played)
        except (PhysicsError, WorkerError) as failure:
            self.close()
            reason = failure.reason
            raise SimulationFailure(failure.simulation, len(played), reason) from failure
        except BaseException:
            self.close()
            raise

    def film(self, shown: int, stride: int, size: tuple[int, int]) -> bool:
        try:
            renderer = self.stepper.renderer(self.tasks[0])
        except WorkerError as failure:
            self.close()
            raise RunError(f"`{self.env.name}` cannot be filmed: {failure.reason}") from failure
        self._camera = _Camera(renderer, shown, stride, size) if renderer else None
        return self._camera is not None

    def close(self) -> None:
        self.stepper.close()

    def _played(self, act: Act, actors: Actors, start: Any, played: list[Decision]) -> Trajectory:
        """Play, and keep the decisions so far in `played`."""
        batch = actors.z.shape[:2]
        previous_action: Array | np.ndarray = np.zeros((*batch, self.env.action_size), np.float32)
        ended: Array | np.ndarray = np.zeros(batch, bool)
        recurrent_state = actors.trial_state.recurrent_state
        readings = [self.stepper.begin(start, actors.tasks)]
        self.pictures = []
        self._take_pictures(0, ended.size)
        for step in range(self.env.horizon):
            moment = Moment(
                step=np.asarray(step, np.int32),
                readings=readings[-1],
                previous_readings=readings[max(step - 1, 0)],
                previous_action=previous_action,
                recurrent_state=recurrent_state,
                ended=ended,
            )
            decision = act(actors, moment)
            over = np.asarray(decision.ended).ravel()
            # Controls of episodes that have ended may be NaN.
            control = np.where(over[:, None], np.float32(0.0), np.asarray(decision.control))
            readings.append(self.stepper.step(control, over))
            played.append(decision)
            self._take_pictures(step + 1, ended.size)
            previous_action, ended = decision.action, decision.ended
            recurrent_state = decision.recurrent_state
        action, behaviour = _stacked([(one.action, one.behaviour) for one in played])
        return Trajectory(_stacked(readings), action, behaviour, recurrent_state)

    def _take_pictures(self, time: int, num_simulations: int) -> None:
        camera = self._camera
        if camera and (time % camera.stride == 0 or time == self.env.horizon):
            drawn = camera.renderer(min(camera.shown, num_simulations))
            padded = (ImageOps.pad(Image.fromarray(x), camera.size, color="white") for x in drawn)
            self.pictures.append([np.asarray(picture) for picture in padded])


def _stacked(steps: list[Any]) -> Any:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *steps)
