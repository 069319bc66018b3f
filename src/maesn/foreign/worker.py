"""The program of a worker process, which hosts environments with Gymnasium's interface.

`maesn.foreign.pool` starts this file in the interpreter of the environments, Python 3.10 or later.
So it imports the standard library and NumPy alone, neither Gymnasium nor this package. What goes
over the wire is made of Python's own types; an array is (type, shape, bytes).

It ends when its connection is closed; if an environment hangs then, `maesn.foreign.guard` kills it.
"""

import contextlib
import json
import mmap
import os
import pickle
import signal
import struct
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

if sys.version_info < (3, 10):  # noqa: UP036  # of the environments' interpreter
    sys.exit(f"environments need Python 3.10 or later, this is {sys.version.split()[0]}")

# Changes whenever a request or an answer does.
PROTOCOL = 2
# Before each call of an environment, the worker writes the number of calls so far and the
# environment's index to shared memory. So the pool can tell which environment hangs.
MARK = struct.Struct("=Qq")
# Names under which environments report success; the first is Gymnasium's goal environments'.
_SUCCESS = ("is_success", "success")
# Where the files begin that a user has not written: these here, and what imports modules.
_NO_USERS = (f"{Path(__file__).parent}/", import_module.__code__.co_filename, "<frozen importlib")
# Most characters of a message that are shown: a user's may have millions.
_LONGEST = 1000


class HostedError(Exception):
    """An environment broke its contract; the message says how."""


class HostedEnvironment:
    """An environment that plays one episode after the other, of any task.

    After its end, an episode keeps its last reading with reward 0 while others go on: the
    environment is not stepped again before it is reset. A reading is a vector of single precision:
    the observation, flattened, then the reward and whether the episode is terminated, truncated and
    solved. `make_env` is called once if its environment has a method `set_task`, and for every new
    task otherwise. All tasks must have the `spaces` of `facts`; None for the first one's.
    """

    def __init__(self, make_env: Any, reward: str, spaces: dict[str, Any] | None = None) -> None:
        self._make_env = make_env
        self._reward = reward
        self._spaces = spaces
        self._env: Any = None
        self._task: bytes | None = None
        self._last = np.zeros(0, np.float32)
        self._ended = True

    def facts(self, task: bytes) -> dict[str, Any]:
        """Return what the environment of a task says of itself."""
        env = self._with_task(task)
        inner = getattr(env, "unwrapped", env)
        has_steps = inner is not env and _action_layout(env.action_space)[0] in ("Box", "Discrete")
        repeats, clocks = self._first_steps(env, inner) if has_steps else ([1], [])
        own = getattr(getattr(env, "spec", None), "max_episode_steps", None)
        return {
            "spaces": self._spaces,
            "inner_action": _action_layout(inner.action_space),
            "max_episode_steps": min(clocks, default=own),
            "dt": _number(getattr(inner, "dt", None)),
            "rates": [_number(one.metadata.get("render_fps")) for one in (inner, env)],
            "repeats": repeats,
        }

    def _first_steps(self, env: Any, inner: Any) -> tuple[list[int], list[int]]:
        """Return how many steps of the innermost environment two steps make, as wrappers repeat it.

        And the steps of an episode that each clock in between (`TimeLimit`) allows.
        """
        original = inner.step
        counts = [0]  # first those of the reset, which may play some steps itself

        def step(action: Any) -> Any:
            counts[-1] += 1
            return original(action)

        still = np.zeros(len(_action_layout(self._action_space)[1]))
        with contextlib.suppress(AttributeError):  # where nobody can look on
            inner.step = step
        try:
            _ask("reset", lambda: env.reset(seed=0))
            for _ in range(2):
                counts.append(0)
                result = _ask("step", lambda: env.step(_action(self._action_space, still)))
                # What is no such tuple is refused when an episode is played.
                if not isinstance(result, tuple) or any(result[2:4]):
                    break
        finally:
            with contextlib.suppress(AttributeError):
                del inner.step
        # `TimeLimit` has no public names for these two.
        clocks = [vars(one) for one in _layers(env) if vars(one).get("_elapsed_steps")]
        steps = len(counts) - 1
        lengths = [-(-steps * one["_max_episode_steps"] // one["_elapsed_steps"]) for one in clocks]
        return [count or 1 for count in counts[1:]], lengths

    def begin(self, task: bytes, seed: int) -> np.ndarray:
        """Begin an episode, and return its first reading."""
        env = self._with_task(task)
        result = _ask("reset", lambda: env.reset(seed=seed))
        if not (isinstance(result, tuple) and len(result) == 2):
            raise HostedError(f"`reset` must return (observation, info), got {result!r}")
        return self._read(result[0], 0.0, False, False, result[1])

    def step(self, control: np.ndarray) -> np.ndarray:
        """Step the environment with a control, unless its episode has ended; return the reading."""
        if self._ended:
            self._last[-4] = 0.0
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
        return self._read(*result)

    def renders(self, task: bytes) -> bool:
        """Return whether the environment of a task draws itself."""
        return bool(getattr(self._with_task(task), "render_mode", None) == "rgb_array")

    def picture(self, library: str | None) -> Any:
        """Return the environment's picture of its present state, `[height, width, 3]`, packed.

        MuJoCo draws with that library, unless the variable MUJOCO_GL says so. It is set no earlier
        than here: MuJoCo's import fails where the library cannot be used.
        """
        if library is not None:
            os.environ.setdefault("MUJOCO_GL", library)
        drawn = _ask("render", self._env.render)
        picture = np.asarray(drawn)
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            raise HostedError(
                "`render` must return a picture, an array of bytes `[height, width, 3]`, got "
                f"{type(drawn).__name__} of {picture.dtype} {list(picture.shape)}"
            )
        return packed(picture)

    def close(self) -> None:
        """Close the environment."""
        if self._env is not None:
            env, self._env = self._env, None
            _ask("close", env.close)

    def _with_task(self, task: bytes) -> Any:
        if self._env is not None and task == self._task:
            return self._env
        value = pickle.loads(task)
        set_task = [one.set_task for one in _layers(self._env) if hasattr(one, "set_task")]
        if set_task:
            _ask("set_task", lambda: set_task[0](value))
        else:
            self.close()
            self._env = _ask("make_env", lambda: self._make_env(value, self._reward))
        env = self._env
        if not (hasattr(env, "reset") and hasattr(env, "step")):
            raise HostedError(f"`make_env` must return a `gymnasium.Env`, got {env!r}")
        # Kept, because every look-up goes through all wrappers.
        self._action_space = env.action_space
        self._shape = env.observation_space.shape
        found = {
            "observation": _observation_layout(env.observation_space),
            "action": _action_layout(self._action_space),
        }
        self._spaces = self._spaces or found
        for name, space in found.items():
            if space != self._spaces[name]:
                raise HostedError(
                    f"the {name} space must be that of the family's first task in every task, "
                    f"{self._spaces[name]}, got {space}"
                )
        self._task = task
        return env

    def _read(
        self, observation: Any, reward: Any, terminated: Any, truncated: Any, info: Any
    ) -> np.ndarray:
        vector = _ask("the observation", lambda: _numbers(observation, self._shape))
        try:
            gain = float(reward)
        except (TypeError, ValueError) as error:
            raise HostedError(f"the reward must be a number, got {reward!r}") from error
        ends = _truth("terminated", terminated), _truth("truncated", truncated)
        self._ended = any(ends)
        with np.errstate(over="ignore"):  # the pool refuses what is infinite in single precision
            self._last = np.concatenate([vector, (gain, *ends, _solved(info))]).astype(np.float32)
        return self._last


def _ask(what: str, question: Callable[[], Any]) -> Any:
    """Call a user's code, and turn its exceptions into a `HostedError`."""
    try:
        return question()
    except HostedError:
        raise
    except Exception as error:
        name = what if " " in what else f"`{what}`"
        raise HostedError(f"{name} {_raised(error)}") from error


def _layers(env: Any) -> Iterator[Any]:
    """Yield an environment and all that it wraps, from outside."""
    while env is not None:
        yield env
        env = None if env is getattr(env, "unwrapped", env) else env.env


def _number(value: Any) -> float | None:
    usable = isinstance(value, int | float | np.number) and 0 < value < np.inf
    return float(value) if usable else None


def _kind(space: Any) -> str:
    """Return the kind of a space by its name, as no module of Gymnasium is imported."""
    names = [one.__name__ for one in type(space).__mro__]
    return next((name for name in names if name in ("Box", "Discrete")), names[0])


def _action_layout(space: Any) -> list[Any]:
    """Return kind and bounds of an action space, flattened; the text of one of another kind."""
    if _kind(space) == "Discrete":
        return ["Discrete", [0.0] * int(space.n), [1.0] * int(space.n)]
    if _kind(space) == "Box" and space.dtype.kind == "f":
        return ["Box", space.low.ravel().tolist(), space.high.ravel().tolist()]
    return [str(space), [], []]


def _action(space: Any, control: np.ndarray) -> Any:
    if _kind(space) == "Discrete":
        return space.start + int(np.argmax(control))
    action = control.astype(space.dtype).reshape(space.shape)
    # Rounding to single precision may pass a bound. (`np.clip` is slower on so few numbers.)
    return np.minimum(np.maximum(action, space.low), space.high)


def _observation_layout(space: Any) -> list[Any]:
    """Return a text that is equal for spaces of one shape, and a name for each component."""
    if _kind(space) != "Box":
        raise HostedError(
            f"the observation space must be a `Box`, got {space}: wrap the environment in "
            "`gymnasium.wrappers.FlattenObservation`"
        )
    names = [f"observation[{index}]" for index in range(int(np.prod(space.shape)))]
    return [f"Box{list(space.shape)}", names]


def _numbers(observation: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return an observation as a vector. Types and bounds are free: many miss theirs by little."""
    numbers = np.asarray(observation)
    if numbers.shape != shape:
        raise HostedError(
            f"the observation must have the shape {shape} of its space, got {numbers.shape}"
        )
    if numbers.dtype.kind not in "biuf":
        raise HostedError(f"the observation must hold numbers, got {observation!r}")
    return numbers.ravel().astype(np.float64)


def _truth(name: str, value: Any) -> bool:
    # 0 and 1 are equal to Python's and NumPy's truth values.
    if np.asarray(value).size != 1 or value not in (0, 1):
        raise HostedError(f"`{name}` must be a truth value, got {value!r}")
    return bool(value)


def _solved(info: Any) -> bool:
    if not isinstance(info, Mapping):
        raise HostedError(f"`info` must be a dictionary, got {info!r}")
    found = [name for name in _SUCCESS if name in info]
    return bool(found) and _truth(f'info["{found[0]}"]', info[found[0]])


def packed(array: np.ndarray) -> tuple[str, tuple[int, ...], bytes]:
    """Return an array as Python's own types."""
    return array.dtype.str, array.shape, array.tobytes()


def unpacked(parts: tuple[str, tuple[int, ...], bytes]) -> np.ndarray:
    """Return the array of `packed`, which cannot be written to."""
    kind, shape, content = parts
    return np.frombuffer(content, kind).reshape(shape)


def described(error: BaseException) -> str:
    """Return type and message of an error. The message may be long, or raise an error itself."""
    try:
        message = str(error)
    except Exception:  # noqa: BLE001
        message = "(its message cannot be shown)"
    return _shortened(f"{type(error).__name__}: {message}")


def _raised(error: BaseException) -> str:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"raised {described(error)} ({frame.filename}, line {frame.lineno})"


def _shortened(text: str, limit: int = _LONGEST) -> str:
    left_out, half = len(text) - limit, limit // 2
    if left_out <= 0:
        return text
    return f"{text[:half]} ... ({left_out:,} characters left out) ... {text[-half:]}"


def _user_traceback(error: BaseException | None) -> str:
    """Return the traceback of an error within a user's code; an empty text without an error."""
    calls = traceback.extract_tb(error.__traceback__) if error else []
    lines = traceback.format_list([one for one in calls if not one.filename.startswith(_NO_USERS)])
    return _shortened("".join(lines), 4 * _LONGEST)


class _Failure(Exception):
    """One of the environments cannot go on: its index, the reason, and its lines of traceback."""


class _Share:
    """The environments of one worker.

    Args:
        recipe: arguments of `HostedEnvironment`, pickled.
        mark: memory for `MARK`, which the pool reads.
    """

    def __init__(self, recipe: bytes, mark: mmap.mmap) -> None:
        self._mark = mark
        self._calls = 0
        self._environments: list[HostedEnvironment] = []
        try:
            make_env, *others = pickle.loads(recipe)
            if isinstance(make_env, str):
                module, _, name = make_env.partition(":")
                make_env = getattr(import_module(module), name)
        except Exception as error:  # a user's module can raise anything
            reason = f"`make_env` cannot be loaded by {sys.executable}: {described(error)}"
            raise _Failure(0, reason, _user_traceback(error)) from error
        self._recipe = (make_env, *others)

    def answer(self, request: str, columns: Sequence[Any]) -> Any:
        """Call a method of one environment after the other, with one value of each column.

        Returns the results; readings as one packed array.
        """
        if request == "step":
            columns = [unpacked(columns[0])]
        answers = [self._call(request, *one) for one in enumerate(zip(*columns, strict=True))]
        return packed(np.stack(answers)) if request in ("begin", "step") else answers

    def _call(self, request: str, index: int, arguments: tuple[Any, ...]) -> Any:
        self._calls += 1
        MARK.pack_into(self._mark, 0, self._calls, index)
        if index == len(self._environments):
            self._environments.append(HostedEnvironment(*self._recipe))
        try:
            return getattr(self._environments[index], request)(*arguments)
        except HostedError as error:
            trace = _user_traceback(error.__cause__)
            raise _Failure(index, _shortened(str(error)), trace) from error
        except Exception as error:  # of a user's code, wherever it is called
            trace = _user_traceback(error)
            raise _Failure(index, f"the environment {_raised(error)}", trace) from error

    def close(self) -> None:
        """Close all environments, and ignore their errors."""
        for environment in self._environments:
            with contextlib.suppress(Exception):
                environment.close()


def _serve(connection: Connection, mark: mmap.mmap) -> None:
    share = None
    try:
        share = _Share(connection.recv_bytes(), mark)
        while True:
            request, columns = connection.recv()
            connection.send((share.answer(request, columns), None))
    except _Failure as failure:
        connection.send((None, failure.args))
        connection.recv()  # the pool reads the failure, and closes
    finally:
        if share is not None:
            share.close()


def main(protocol: str, connection: str, mark: str, path: str) -> None:
    """Serve the parent process, of the same protocol, until it closes the connection.

    Args:
        protocol: version of the parent's.
        connection: file descriptor of a socket to the parent, which sends the recipe of a `_Share`
            and then requests: name and columns. Answers are (result, None) or (None, failure).
        mark: file descriptor of the memory for `MARK`, which both processes map.
        path: where modules are looked for, as JSON; null for this interpreter's own.
    """
    if int(protocol) != PROTOCOL:
        sys.exit(f"the library speaks version {protocol} of the protocol, this file {PROTOCOL}")
    # Schedulers signal all processes of a job. The parent then saves, and ends this process. Hence
    # an empty handler, and not SIG_IGN, which the environments' own processes would inherit.
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: None)
    # The place of this file is no place of modules; the one of those for known simulators is.
    own = str(Path(__file__).with_name("adapters"))
    sys.path[:] = [*(json.loads(path) or [*sys.path[1:], str(Path.cwd())]), own]
    with mmap.mmap(int(mark), MARK.size) as shared, contextlib.suppress(EOFError, OSError):
        _serve(Connection(int(connection)), shared)


if __name__ == "__main__":
    main(*sys.argv[1:])
