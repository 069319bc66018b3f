"""The command line. This module answers `--help` alone; a command's imports wait for its turn."""

import os
import signal
import sys
import threading
import traceback
from importlib import import_module
from typing import Any

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
    "export": "write a trained policy as one file for the NumPy runtime",
    "render": "film a trained policy in a new task, before and after adaptation",
    "list": "list methods, rules, families of tasks, and policies that come with the library",
    "doctor": "show versions, engine, cores, graphics card and cache; let a robot drive",
    "demo": "train MAESN on the wheeled robot, adapt it to unseen tasks, draw the figures",
}

# Command -> the file of `maesn.commands` with the function of that name; the others are in `runs`.
_FILES = {"compare": "studies", "study": "studies"} | {n: n for n in ("doctor", "list", "train")}

_HELP = """usage: maesn COMMAND [OPTIONS]

Meta-reinforcement learning of structured exploration strategies.

commands:
{}

`maesn COMMAND --help` lists the options of a command; `maesn --version` the version.""".format(
    "\n".join(f"  {name:8s}  {text}" for name, text in COMMANDS.items())
)
_ANSWERS = {"--version": f"maesn {__version__}", "--help": _HELP, "-h": _HELP}

# Shows the traceback of an error behind its sentence.
TRACEBACK = "MAESN_TRACEBACK"

FAULT = 1  # an error that the library does not expect
USAGE_ERROR = 2
INTERRUPTED = 130  # what shells report of a program that Ctrl-C ended


def main() -> None:
    """Run the command that the arguments name, and exit."""
    sys.unraisablehook = _keep_interrupts
    if signal.getsignal(signal.SIGINT) == signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    try:
        code = run(sys.argv[1:])
    except KeyboardInterrupt:  # before a command has begun
        code = INTERRUPTED
    # From here on JAX cleans up: one more Ctrl-C would show a traceback of that.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(code)


def _interrupt(*_: object) -> None:
    """Stop as Ctrl-C does; a second one ends the process at once."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    raise KeyboardInterrupt


def _keep_interrupts(event: Any) -> None:
    """Repeat a Ctrl-C that came where Python drops it, as in a callback of JAX."""
    if issubclass(event.exc_type, KeyboardInterrupt):
        signal.signal(signal.SIGINT, _interrupt)
        threading.Timer(0.01, os.kill, [os.getpid(), signal.SIGINT]).start()
    else:
        sys.__unraisablehook__(event)


def run(arguments: list[str]) -> int:
    """Run one command; return 0, or 2 for a mistake in the options or in what they point to.

    Any other error is 1. Whatever goes wrong is said in one sentence.
    """
    if not all(arguments) or any("\0" in argument for argument in arguments):
        print("maesn: an argument is empty or holds a NUL character: check it.", file=sys.stderr)
        return USAGE_ERROR
    name, *options = arguments or ["--help"]
    if name in COMMANDS:
        return _run_command(name, options)
    if name in _ANSWERS:
        print(_ANSWERS[name])
        return 0
    known, hint = ", ".join(COMMANDS), suggestion(name, COMMANDS)
    print(f"maesn: there is no command `{name}`.{hint} Known are: {known}.", file=sys.stderr)
    return USAGE_ERROR


def _run_command(name: str, options: list[str]) -> int:
    try:
        file = import_module(f"maesn.commands.{_FILES.get(name, 'runs')}")
        getattr(file, name)(options)
    except SystemExit:  # of a parser that has said all; also keeps the imports below away
        raise
    except BrokenPipeError:  # whoever reads our output has seen enough
        sys.stderr.close()
    except KeyboardInterrupt:
        print(f"maesn {name}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:  # noqa: BLE001
        if TRACEBACK in os.environ:
            traceback.print_exception(error)
        sentence, code = _explained(error)
        print(f"maesn {name}: {sentence}", *_notes(error), sep="\n", file=sys.stderr)
        return code
    return 0


def _notes(error: BaseException | None) -> list[str]:
    """Return what an error and its causes say beside their messages."""
    notes: list[str] = []
    while error is not None:
        notes += getattr(error, "__notes__", [])
        error = error.__cause__
    return notes


def _explained(error: Exception) -> tuple[str, int]:
    """Return an error as a sentence, and the exit code that belongs to it."""
    from maesn.physics import EngineError, RenderingError
    from maesn.storage import RunError
    from maesn.worlds import EpisodeError

    if isinstance(error, RunError | EngineError | RenderingError | EpisodeError):
        return str(error), USAGE_ERROR
    if isinstance(error, OSError):
        named = f": `{str(error.filename)[:200]}`" if error.filename else ""
        return f"{error.strerror or error}{named}", USAGE_ERROR
    *_, where = traceback.extract_tb(error.__traceback__)
    said = (str(error).splitlines() or ["no more is said"])[0]
    at = f"{where.filename}, line {where.lineno}"
    return f"{type(error).__name__} in {at}: {said} ({TRACEBACK}=1 shows how it came to it)", FAULT
