"""What a user's code has raised, in few characters."""

import traceback
from pathlib import Path

# Characters of a message, of which a user's may have millions.
_LONGEST = 1000
# Calls of a user's code that are shown of an error, the outermost and the innermost.
_CALLS = 6


def raised(error: Exception) -> str:
    """Return what was raised, and where, as the end of a sentence."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"raised {described(error)} ({frame.filename}, line {frame.lineno})"


def described(error: Exception) -> str:
    """Return type and message of a user's error, whose message may be long or raise another one."""
    try:
        message = str(error)
    except Exception:  # noqa: BLE001
        message = "(its message cannot be shown)"
    return shortened(f"{type(error).__name__}: {message}")


def shortened(text: str, limit: int = _LONGEST) -> str:
    """Return beginning and end of a text that has more characters than the limit."""
    left_out = len(text) - limit
    if left_out <= 0:
        return text
    half = limit // 2
    return f"{text[:half]} ... ({left_out:,} characters left out) ... {text[-half:]}"


def calls_of(error: BaseException | None) -> str:
    """Return the calls of a user's code in which an error was raised; nothing without one."""
    calls = traceback.extract_tb(error.__traceback__) if error else []
    theirs = [call for call in calls if Path(call.filename).parent != Path(__file__).parent]
    lines = traceback.format_list(theirs)  # repeated ones are counted
    if len(lines) > 2 * _CALLS:
        lines[_CALLS:-_CALLS] = [f"  ... ({len(lines) - 2 * _CALLS} calls left out)\n"]
    return shortened("".join(lines), 4 * _LONGEST)
