"""Short texts about exceptions of a user's code."""

import traceback
from pathlib import Path

# Most characters of a message that are shown: a user's may have millions.
_LONGEST = 1000
# Calls that are shown at each end of a traceback.
_CALLS = 6


def raised(error: Exception) -> str:
    """Return "raised <error> (<file>, line <number>)", the end of a sentence."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"raised {described(error)} ({frame.filename}, line {frame.lineno})"


def described(error: Exception) -> str:
    """Return type and message of an error. The message may be long, or raise an error itself."""
    try:
        message = str(error)
    except Exception:  # noqa: BLE001
        message = "(its message cannot be shown)"
    return shortened(f"{type(error).__name__}: {message}")


def shortened(text: str, limit: int = _LONGEST) -> str:
    """Return a text, without its middle if it has more characters than the limit."""
    left_out = len(text) - limit
    if left_out <= 0:
        return text
    half = limit // 2
    return f"{text[:half]} ... ({left_out:,} characters left out) ... {text[-half:]}"


def user_traceback(error: BaseException | None) -> str:
    """Return the traceback of an error within a user's code; an empty text without an error."""
    calls = traceback.extract_tb(error.__traceback__) if error else []
    theirs = [call for call in calls if Path(call.filename).parent != Path(__file__).parent]
    lines = traceback.format_list(theirs)  # collapses repeated calls
    if len(lines) > 2 * _CALLS:
        lines[_CALLS:-_CALLS] = [f"  ... ({len(lines) - 2 * _CALLS} calls left out)\n"]
    return shortened("".join(lines), 4 * _LONGEST)
