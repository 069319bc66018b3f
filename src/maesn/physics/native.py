"""The MuJoCo engine on the host: simulations of one model on a pool of threads."""

import importlib
import os
from types import ModuleType
from typing import Any, Literal, TypeAlias

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from maesn.physics.base import (
    CURRENT,
    LARGEST,
    ModelFields,
    PhysicsError,
    Readings,
    check_rows,
    is_sound,
    sound_rows,
)
from maesn.physics.interface import field_values
from maesn.physics.loading import load_model
from maesn.settings import check_choice, check_number
from maesn.storage import RunError

_Mask: TypeAlias = Bool[np.ndarray, " simulation"]


class NativeSimulator:
    """Simulations on `mujoco.batch.Batch`, bit-identical at any number of threads.

    It is the one stateful object of a rollout: it holds where every simulation is. It knows no
    task, no reward and no episode. Row i of every array is simulation i. Not to be shared between
    Python threads. Threads and memory are released with the last reference to it.

    Readings beyond the state itself ("subtree_com", "sensordata", ...) cost a forward pass per
    step, without which they would be one substep old.

    Non-finite physics is silent in MuJoCo: a control that is NaN becomes 0, and a state that blows
    up is reset or carried on. So controls are checked before every step, and the state and
    MuJoCo's warning counters after it.

    Args:
        model: as for `load_model`.
        num_simulations: how many simulations move together.
        readings: names of the fields of `mujoco.MjData` that `reset` and `step` return.
        frame_skip: physics steps per control step.
        num_threads: threads that share the work; 0 means one for each CPU.
        nonfinite: what happens when a simulation blows up: "raise" a `PhysicsError`, or "report"
            the state as it is, for families in which this ends an episode.

    Raises:
        RunError: the installed MuJoCo is older than 4.0.
        ValueError: an argument is out of range, or MuJoCo knows no reading of that name. Else it
            raises as `load_model`.
    """

    def __init__(
        self,
        model: str | os.PathLike[str],
        num_simulations: int,
        readings: tuple[str, ...] = ("qpos", "qvel"),
        frame_skip: int = 1,
        num_threads: int = 0,
        nonfinite: Literal["raise", "report"] = "raise",
    ) -> None:
        check_number("frame_skip", frame_skip, 1)
        check_number("num_threads", num_threads, 0)
        check_choice("nonfinite", nonfinite, ("raise", "report"))
        self._engine = _import_engine()
        self._model = load_model(model)
        self._batch: Any = self._engine.Batch(self._model, num_simulations, num_threads)
        self._num_simulations = num_simulations
        self._frame_skip = frame_skip
        self._raises = nonfinite == "raise"
        self._expanded: set[str] = set()
        self._qpos, self._qvel, self._control = map(self._batch.bind, ("qpos", "qvel", "ctrl"))
        self._readings = {name: self._batch.bind(name) for name in readings}
        self._derives = not CURRENT.issuperset(readings)
        stage = mujoco.mjtStage.mjSTAGE_ACC if self._derives else mujoco.mjtStage.mjSTAGE_NONE
        self._stage = int(stage)

    def reset(
        self,
        qpos: Float[np.ndarray, "simulation qpos"],
        qvel: Float[np.ndarray, "simulation qvel"],
        model_fields: ModelFields | None = None,
    ) -> Readings:
        """Put all simulations into a state, as if they had just been made; return the readings.

        Args:
            qpos: generalised positions.
            qvel: generalised velocities.
            model_fields: dynamics that differ between simulations. Fields that are not named have
                the model's own values, whatever an earlier reset gave them.

        Raises:
            PhysicsError: a state or a field is not finite.
        """
        check_rows("qpos", qpos, self._qpos)
        check_rows("qvel", qvel, self._qvel)
        self._batch.reset(stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self._write_model_fields(model_fields or {})
        self._qpos[...] = qpos
        self._qvel[...] = qvel
        if self._derives:
            self._run(self._batch.forward)
        return self._read()

    def step(
        self, control: Float[np.ndarray, "simulation control"], abandoned: _Mask | None = None
    ) -> Readings:
        """Advance every simulation by one control step, and return readings, none a substep behind.

        Args:
            control: input of the actuators, constant during the step.
            abandoned: simulations whose results are ignored until the next reset: they may blow up.

        Raises:
            PhysicsError: a control is not finite, or a simulation that counts has blown up.
        """
        check_rows("control", control, self._control)
        self._control[...] = control
        self._run(self._batch.step, abandoned, nstep=self._frame_skip, stage=self._stage)
        return self._read()

    def _run(self, call: Any, abandoned: _Mask | None = None, **arguments: Any) -> None:
        watched = np.ones(self._num_simulations, bool) if abandoned is None else ~abandoned
        try:
            call(**arguments)
        except self._engine.SimulationError as error:
            failed = error.ids[watched[error.ids]]
            if failed.size:
                raise PhysicsError(int(failed[0]), str(error)) from error
        if self._raises:
            self._check_physics(watched)

    def _check_physics(self, watched: _Mask) -> None:
        # Copies, since the engine's own arrays are strided, and slow to read twice.
        states = np.array(self._qpos), np.array(self._qvel)
        if all(map(is_sound, states)) and not self._batch.warning.any():
            return
        # A reset clears the counters, so whatever they hold happened since then.
        count = self._batch.warning[:, :, 1]
        failed = ~(sound_rows(self._qpos) & sound_rows(self._qvel)) | count.any(axis=1)
        if (failed & watched).any():
            first = int(np.argmax(failed & watched))
            raise PhysicsError(first, self._reason(first))

    def _reason(self, simulation: int) -> str:
        info, count = self._batch.warning[simulation].T
        if not count.any():
            return (
                f"the state must stay finite and below {LARGEST:.0e} in size, got "
                f"qpos {self._qpos[simulation]} and qvel {self._qvel[simulation]}: shorten the "
                "model's time step, or bound what drives it"
            )
        first = int(np.flatnonzero(count)[0])
        said = mujoco.mju_warningText(first, int(info[first])).rstrip(".")
        return f"MuJoCo warns: {said}"

    def _read(self) -> Readings:
        # The engine's arrays are live: the next step writes over them.
        return {name: np.array(value, np.float64) for name, value in self._readings.items()}

    def _write_model_fields(self, fields: ModelFields) -> None:
        """Give simulations their own dynamics, and the model's own to fields not named."""
        for name, own in field_values(self._model, self._expanded - fields.keys()).items():
            self._batch.expand(name)[...] = own
        for name, value in fields.items():
            expanded = self._batch.expand(name)
            check_rows(name, value, expanded)
            expanded[...] = value
        if fields or self._expanded:
            # Inertia weights and the like follow from the fields: the solver reads those.
            self._run(self._batch.set_const)
        self._expanded |= fields.keys()


def _import_engine() -> ModuleType:
    try:
        return importlib.import_module("mujoco.batch")
    except ImportError as error:
        raise RunError(
            "the physics needs mujoco >= 4.0, which brings `mujoco.batch`, but found mujoco "
            f"{mujoco.__version__}: install a newer MuJoCo."
        ) from error
