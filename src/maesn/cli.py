"""The command line. This module answers `--help` alone; a command's imports wait for its turn."""

import shlex
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from maesn._version import __version__
from maesn.settings import suggestion

# Command -> its line of help.
COMMANDS = {
    "train": "meta-train a method on a family of tasks",
    "resume": "go on with a run from its latest checkpoint",
    "adapt": "adapt a trained policy to new tasks, and tabulate how it does",
    "prior": "play an archive of latents in the training tasks, for the rule `search`",
    "compare": "adapt runs and methods from scratch to the same tasks: one figure, one table",
    "study": "train, adapt and compare what a file says; go on with it, show how far it is",
    "report": "draw the figures of runs, or figures and tables of a study",
    "export": "write a trained policy as one file for the NumPy runtime of a robot",
    "render": "film a trained policy in a new task, before and after adaptation",
    "list": "list methods, rules, families of tasks, and policies that come with the library",
    "doctor": "show versions, cores, graphics card and cache; let a robot drive",
}

# Command -> the file of `maesn.commands` with the function of that name; the others are in `runs`.
_FILES = {"doctor": "about", "list": "about", "train": "train"}

_HELP = """usage: maesn COMMAND [OPTIONS]

Meta-reinforcement learning of structured exploration strategies.

commands:
{}

`maesn COMMAND --help` lists the options of a command; `maesn --version` the version.
Those that play take `--python PATH/bin/python`: environments of others run there.""".format(
    "\n".join(f"  {name:8s}  {text}" for name, text in COMMANDS.items())
)
_ANSWERS = {"--version": f"maesn {__version__}", "--help": _HELP, "-h": _HELP}

# In a note that JAX adds to what is raised inside of its functions; we show no traceback.
_ABOUT_TRACEBACKS = "JAX_TRACEBACK_FILTERING"

USAGE_ERROR = 2
INTERRUPTED = 130  # what shells report of a program that Ctrl-C ended


def main() -> None:
    """Run the command that the arguments name, and exit."""
    # So that `module:name` finds a file here. Last: it takes no other module's place.
    sys.path.append(str(Path.cwd()))
    code = run(sys.argv[1:])
    # From here on JAX cleans up: one more Ctrl-C would show a traceback of that.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Run one command; return 0, or 2 for a mistake in the options or in what they point to.

    A mistake is said in one sentence. Errors that the library does not expect are raised.
    """
    name, *options = arguments or ["--help"]
    if not all(arguments or [name]):
        print("maesn: an argument is empty: check it.", file=sys.stderr)
        return USAGE_ERROR
    if name in _ANSWERS:
        print(_ANSWERS[name])
        return 0
    if name not in COMMANDS:
        hint, known = suggestion(name, COMMANDS), ", ".join(COMMANDS)
        print(f"maesn: there is no command `{name}`.{hint} Known are: {known}.", file=sys.stderr)
        return USAGE_ERROR
    try:
        file = import_module(f"maesn.commands.{_FILES.get(name, 'runs')}")
        with _interpreter(options) as others:
            getattr(file, name)(others)
    except BrokenPipeError:  # whoever reads our output has seen enough
        sys.stderr.close()
    except KeyboardInterrupt:
        print(f"maesn {name}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        if not _is_mistake(error):
            raise
        said = [f"maesn {name}: {error}", *_notes(error), *_commands(error, arguments)]
        print(*said, sep="\n", file=sys.stderr)
        return USAGE_ERROR
    return 0


@contextmanager
def _interpreter(options: list[str]) -> Iterator[list[str]]:
    """Take `--python PATH` out of a command's options; until it ends, environments run there."""
    from maesn.commands.options import read_first

    found, others = read_first(options, "python")
    if found.python is None:
        yield options
        return
    from maesn.foreign import hosted_in

    with hosted_in(found.python):
        yield others


def _notes(error: BaseException | None) -> list[str]:
    """Return what is known beside messages, as when a user's environment raised in a process."""
    if error is None:
        return []
    own = [note for note in getattr(error, "__notes__", []) if _ABOUT_TRACEBACKS not in note]
    return [*own, *_notes(error.__cause__)]


def _commands(error: Exception, arguments: list[str]) -> list[str]:
    """Return the whole command to type where only a name was missing."""
    from maesn.runs.config import NotNamedError

    if not isinstance(error, NotNamedError):
        return []
    given = {argument.partition("=")[0] for argument in arguments}
    missing = {name: own for name, own in error.named.items() if f"--{name}" not in given}
    if not missing or "method" in error.named.keys() - missing.keys():
        return ["One option names one module: give one that imports what all the runs need."]
    options = (f" --{name} {own}" for name, own in missing.items())
    return [f"Type: maesn {shlex.join(arguments)}{''.join(options)}"]


def _is_mistake(error: Exception) -> bool:
    from maesn.physics import RenderingError
    from maesn.storage import RunError
    from maesn.worlds import EpisodeError

    return isinstance(error, RunError | RenderingError | EpisodeError | OSError)
