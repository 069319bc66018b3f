"""One environment inside a worker: begun, stepped, and checked at every step."""

import pickle
import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from jaxtyping import UInt8
from PIL import Image, ImageOps

from maesn.foreign.errors import described, raised
from maesn.foreign.interface import Interface, InterfaceError, describe
from maesn.foreign.observations import fault

# Names under which environments report success; the first is Gymnasium's goal environments'.
_SUCCESS = ("is_success", "success")
# Larger numbers are infinite in the policies' single precision. It is a double so that NumPy
# compares in double precision: in half precision the bound itself would be infinite.
_LARGEST = np.float64(np.finfo(np.float32).max)


class Reading(NamedTuple):
    """The checked result of `reset` or `step`."""

    observation: np.ndarray
    reward: float
    terminated: bool
    truncated: bool
    solved: bool


class HostedError(Exception):
    """An environment broke its contract; the message says how."""


class HostedEnvironment:
    """An environment that plays one episode after the other, of any task.

    After its end, an episode keeps its last reading with reward 0 while others go on: the
    environment is not stepped again before it is reset.

    Args:
        make_env: the user's function of a task and the kind of reward. It is called once if its
            environment has a method `set_task`, and for every new task otherwise.
        reward: "dense" or "sparse".
        interface: the interface that every task must have; None for that of the first one.
    """

    def __init__(
        self, make_env: Callable[[Any, str], Any], reward: str, interface: Interface | None
    ) -> None:
        self._make_env = make_env
        self._reward = reward
        self._interface = interface
        self._env: gymnasium.Env[Any, Any] | None = None
        # Kept, because every look-up goes through all wrappers.
        self._action_space: spaces.Space[Any] | None = None
        self._observation_space: spaces.Space[Any] | None = None
        self._task: bytes | None = None
        self._last: Reading | None = None

    def describe(self, task: bytes) -> Interface:
        """Return the interface of the environment of a task.

        Args:
            task: pickled.

        Raises:
            HostedError: the environment raised an error, or its spaces are not supported.
        """
        self._with_task(task)
        assert self._interface is not None
        return self._interface

    def begin(self, task: bytes, seed: int) -> Reading:
        """Begin an episode.

        Args:
            task: pickled, so that tasks of any type can be compared.
            seed: seed of the episode.

        Raises:
            HostedError: the environment raised an error, or its result cannot be used.
        """
        env = self._with_task(task)
        result = _ask("reset", lambda: env.reset(seed=seed))
        if not (isinstance(result, tuple) and len(result) == 2):
            raise HostedError(f"`reset` must return (observation, info), got {result!r}")
        observation, info = result
        reading = Reading(self._flatten(observation), 0.0, False, False, _solved(info))
        self._last = reading
        return reading

    def step(self, control: np.ndarray) -> Reading:
        """Step the environment, unless its episode has ended.

        Args:
            control: the action within its bounds, flattened.

        Raises:
            HostedError: the environment raised an error, or its result cannot be used.
        """
        assert self._env is not None
        assert self._action_space is not None
        assert self._last is not None
        if self._last.terminated or self._last.truncated:
            self._last = self._last._replace(reward=0.0)
            return self._last
        if not np.isfinite(control).all():
            raise HostedError(f"the policy's action must be finite, got the control {control}")
        env, action = self._env, _action(self._action_space, control)
        result = _ask("step", lambda: env.step(action))
        if not (isinstance(result, tuple) and len(result) == 5):
            raise HostedError(
                f"`step` must return (observation, reward, terminated, truncated, info), got "
                f"{result!r}"
            )
        observation, reward, terminated, truncated, info = result
        self._last = Reading(
            self._flatten(observation),
            _finite_reward(reward),
            _truth("terminated", terminated),
            _truth("truncated", truncated),
            _solved(info),
        )
        return self._last

    def complaint(self, task: bytes) -> str | None:
        """Return the complaint of Gymnasium's own check; None if there is none.

        The check plays some steps. It demands more than is needed here: exact types and bounds, and
        the same episode for the same seed.
        """
        env = self._with_task(task)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                check_env(env, skip_render_check=True, skip_close_check=True)
        except Exception as error:  # noqa: BLE001  # of a user's code, or the check's
            return described(error)
        return None

    def renders(self, task: bytes) -> bool:
        """Return whether the environment of a task draws itself.

        Args:
            task: pickled.

        Raises:
            HostedError: the environment raised an error, or its spaces are not supported.
        """
        return self._with_task(task).render_mode == "rgb_array"

    def picture(self, size: tuple[int, int]) -> UInt8[np.ndarray, "height width 3"]:
        """Return the environment's picture of its present state, padded to a size.

        Args:
            size: width and height in pixels.

        Raises:
            HostedError: the environment raised an error, or returned no picture.
        """
        assert self._env is not None
        drawn = _ask("render", self._env.render)
        picture = np.asarray(drawn)
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            raise HostedError(
                "`render` must return a picture, an array of bytes `[height, width, 3]`, got "
                f"{type(drawn).__name__} of {picture.dtype} {list(picture.shape)}"
            )
        return np.asarray(ImageOps.pad(Image.fromarray(picture), size, color="white"))

    def close(self) -> None:
        """Close the environment."""
        if self._env is not None:
            env, self._env = self._env, None
            _ask("close", env.close)

    def _with_task(self, task: bytes) -> gymnasium.Env[Any, Any]:
        if self._env is not None and task == self._task:
            return self._env
        value = pickle.loads(task)
        if self._env is not None and self._env.has_wrapper_attr("set_task"):
            set_task = self._env.get_wrapper_attr("set_task")
            _ask("set_task", lambda: set_task(value))
        else:
            self.close()
            self._env = self._made(value)
        self._check_interface(self._env)
        self._action_space = self._env.action_space
        self._observation_space = self._env.observation_space
        self._task = task
        return self._env

    def _made(self, task: Any) -> gymnasium.Env[Any, Any]:
        env = _ask("make_env", lambda: self._make_env(task, self._reward))
        if not isinstance(env, gymnasium.Env):
            raise HostedError(f"`make_env` must return a `gymnasium.Env`, got {env!r}")
        return env

    def _check_interface(self, env: gymnasium.Env[Any, Any]) -> None:
        try:
            found = describe(env)
        except InterfaceError as error:
            raise HostedError(str(error)) from error
        self._interface = self._interface or found
        for name in ("observation", "discrete", "lower", "upper"):
            wanted, got = getattr(self._interface, name), getattr(found, name)
            if wanted != got:
                space = "observation" if name == "observation" else "action"
                raise HostedError(
                    f"the {space} space must be that of the family's first task in every task, "
                    f"with `{name}` {wanted}, got {got}"
                )

    def _flatten(self, observation: Any) -> np.ndarray:
        assert self._interface is not None
        space = self._observation_space
        assert space is not None
        wrong = _ask("the observation", lambda: fault(space, observation))
        if wrong is not None:
            raise HostedError(wrong)
        vector = np.asarray(_ask("the observation", lambda: spaces.flatten(space, observation)))
        if vector.shape != (self._interface.observation_size,):
            raise HostedError(
                f"the observation must have {self._interface.observation_size} components, got "
                f"{vector.size}"
            )
        size = np.abs(vector)
        if not size.max(initial=0) <= _LARGEST:  # nor NaN
            index = int(np.argmin(size <= _LARGEST))
            raise HostedError(
                f"the observation is not finite: component {index} is {vector[index]}"
            )
        return vector.astype(np.float32)


def _ask(what: str, question: Callable[[], Any]) -> Any:
    """Call a user's code, and turn its exceptions into a `HostedError`."""
    try:
        return question()
    except Exception as error:
        name = what if " " in what else f"`{what}`"
        raise HostedError(f"{name} {raised(error)}") from error


def _action(space: spaces.Space[Any], control: np.ndarray) -> Any:
    if isinstance(space, spaces.Discrete):
        return space.start + int(np.argmax(control))
    assert isinstance(space, spaces.Box)
    action = control.astype(space.dtype).reshape(space.shape)
    # Rounding to single precision may pass a bound. (`np.clip` is slower on so few numbers.)
    return np.minimum(np.maximum(action, space.low), space.high)


def _finite_reward(reward: Any) -> float:
    try:
        value = float(reward)
    except (TypeError, ValueError) as error:
        raise HostedError(f"the reward must be a number, got {reward!r}") from error
    if not abs(value) <= _LARGEST:  # nor NaN
        raise HostedError(f"the reward is not finite: {value}")
    return value


def _truth(name: str, value: Any) -> bool:
    try:
        known = value in (0, 1)  # as which Python's and NumPy's truth values count
    except (TypeError, ValueError, RuntimeError):  # of arrays with several elements
        known = False
    if not known:
        raise HostedError(f"`{name}` must be a truth value, got {value!r}")
    return bool(value)


def _solved(info: Any) -> bool:
    if not isinstance(info, Mapping):
        raise HostedError(f"`info` must be a dictionary, got {info!r}")
    for name in _SUCCESS:
        if name in info:
            return _truth(f'info["{name}"]', info[name])
    return False
