"""Calls of the runtime in any order, with good and with bad arguments."""

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from faults.material import Material
from faults.table import CLEAR, CONTINUED, LOSS, TRACEBACK, Findings, is_of_tests
from runtime.robot import contents

from maesn.runtime import Explorer, Safeguards

CALLS = 100
"""In one attempt."""


def attempt(stream: random.Random, material: Material, directory: Path, findings: Findings) -> None:
    """Call methods of one explorer, which is saved and loaded in between."""
    path = stream.choice([*material.policies, *material.explorers])
    explorer = None
    while explorer is None:
        try:
            explorer = Explorer.load(path, stream.randrange(2**32), _safeguards(stream))
        except ValueError:
            findings.add(CLEAR, "safeguards")
    for _ in range(CALLS):
        explorer = _call(stream, explorer, directory, findings)


def _call(
    stream: random.Random, explorer: Explorer, directory: Path, findings: Findings
) -> Explorer:
    call = _usual(stream, explorer)
    if stream.random() < 0.25:
        call = stream.choices(list(CALL_WEIGHTS), list(CALL_WEIGHTS.values()))[0]
    before, what = contents(explorer), f"{call.__name__}: "
    try:
        after, wrong = call(stream, explorer, directory)
    except (ValueError, RuntimeError, OSError) as error:
        changed = contents(explorer) != before
        findings.add(LOSS if changed else CLEAR, f"{what} changed what it refused: {error!r}")
        return explorer
    except Exception as error:  # noqa: BLE001
        findings.add(CLEAR if is_of_tests(error) else TRACEBACK, f"{what}{error!r}")
        return explorer
    findings.add(LOSS if wrong else CONTINUED, what + wrong)
    return after


def _usual(stream: random.Random, explorer: Explorer) -> "Call":
    """What a robot calls next."""
    running = explorer._state.running
    if running is not None:
        return end_episode if running.num_steps >= 1 and stream.random() < 0.3 else act
    return adapt if len(explorer.episodes) >= 2 and stream.random() < 0.4 else begin_episode


def _number(stream: random.Random) -> Any:
    odd = [np.nan, np.inf, -np.inf, 1e308, -1e308, 1e200, 1e100, 1e39, 1e-320, 10**30, None, "x"]
    usual = [stream.gauss(0, 1), stream.gauss(0, 10), 0, 1, True]
    return stream.choice(odd if stream.random() < 0.15 else usual)


def _vector(stream: random.Random, size: int) -> Any:
    values: Any = [_number(stream) if stream.random() < 0.2 else stream.gauss(0, 1)] * size
    values = [value if stream.random() < 0.5 else stream.gauss(0, 1) for value in values]
    odd = [[], [values], values * 2, values[:-1], None, "abc", {}, _number(stream), [[1], [1, 2]]]
    kinds = [np.float16, np.float32, np.float64, object, complex]
    if stream.random() < 0.1:
        return stream.choice(odd)
    if stream.random() < 0.2 and all(type(value) is float for value in values):
        with np.errstate(over="ignore"):
            return np.asarray(values).astype(stream.choice(kinds))
    return values


def _safeguards(stream: random.Random) -> Safeguards | None:
    if stream.random() < 0.3:
        return None
    names = ["lower", "upper", "max_change", "rest", "max_latent_norm"]
    usual = [-0.05, 0.05, 0.02, 0.0, 1.5]
    chosen = {
        name: value for name, value in zip(names, usual, strict=True) if stream.random() < 0.4
    }
    if chosen and stream.random() < 0.3:
        chosen[stream.choice(list(chosen))] = stream.choice([_number(stream), _vector(stream, 2)])
    try:
        return Safeguards(**chosen)
    except TypeError as error:  # no number at all
        raise ValueError(str(error)) from error


Answer = tuple[Explorer, str]
"""The explorer to go on with, and what is wrong; nothing if nothing is."""


def begin_episode(stream: random.Random, explorer: Explorer, _: Path) -> Answer:
    chosen = None if stream.random() < 0.7 else _vector(stream, explorer.exported.latent_size)
    z = explorer.begin_episode(explore=stream.random() < 0.8, z=chosen)
    return explorer, "" if np.isfinite(z).all() and explorer.is_running else f"z = {z}"


def act(stream: random.Random, explorer: Explorer, _: Path) -> Answer:
    running = explorer._state.running
    before = running.controls[-1] if running is not None and running.controls else None
    normalized = stream.random() < 0.2
    observation = _vector(stream, explorer.exported.observation_size)
    answer = explorer.act(observation, stream.random() < 0.8, normalized)
    running = explorer._state.running
    assert running is not None
    return explorer, _beyond(explorer, answer, running.controls[-1], before, normalized)


def _beyond(explorer: Explorer, answer: Any, control: Any, before: Any, normalized: bool) -> str:
    """Return which limit a control is beyond: computed from the limits alone."""
    actuators, safeguards, slack = explorer.exported.actuators, explorer.safeguards, 1e-12
    size = len(actuators.lower)
    low = np.maximum(actuators.lower, safeguards.limit("lower", size, -np.inf))
    high = np.minimum(actuators.upper, safeguards.limit("upper", size, np.inf))
    if not np.isfinite(answer).all() or not np.isfinite(control).all():
        return f"the control is {answer}"
    if (control < low).any() or (control > high).any():
        return f"{control} is not from {low} to {high}"
    if normalized:
        return "" if (np.abs(answer) <= 1 + slack).all() else f"{answer} is beyond -1 to 1"
    start = safeguards.limit("rest", size) if before is None else before
    change = safeguards.limit("max_change", size, np.inf)
    within = (start >= low) & (start <= high)
    fast = within & (np.abs(control - start) > change * (1 + slack) + slack)
    return f"{start} became {control}" if fast.any() else ""


def end_episode(stream: random.Random, explorer: Explorer, _: Path) -> Answer:
    running = explorer._state.running
    kept = len(explorer.episodes) + (running is not None and running.purpose == "explore")
    explorer.end_episode(_vector(stream, 1 if running is None else running.num_steps))
    lost = explorer.is_running or len(explorer.episodes) != kept
    return explorer, "the episode was not kept" if lost else ""


def adapt(_: random.Random, explorer: Explorer, __: Path) -> Answer:
    update = explorer.update
    explorer.adapt()
    latent = np.isfinite([explorer.latent_mean, explorer.latent_std]).all()
    sound = latent and explorer.update == update + 1 and not explorer.episodes
    return explorer, "" if sound else f"the latent is {explorer.latent_mean}"


def discard(_: random.Random, explorer: Explorer, __: Path) -> Answer:
    kept = explorer.episodes
    explorer.discard()
    return explorer, "" if explorer.episodes == kept else "finished episodes are gone"


def control(stream: random.Random, explorer: Explorer, _: Path) -> Answer:
    found = explorer.control(_vector(stream, explorer.exported.action_size))
    return explorer, "" if np.isfinite(found).all() else f"the control is {found}"


def beliefs(_: random.Random, explorer: Explorer, __: Path) -> Answer:
    found = explorer.beliefs
    return explorer, "" if all(np.isfinite(x).all() for x in found) else f"{found}"


def propose(stream: random.Random, explorer: Explorer, _: Path) -> Answer:
    """Propose, and report of one robot."""
    for z in explorer.propose(stream.choice([0, 1, 2, 4]))[:1]:
        explorer.add_result(z, [stream.gauss(0, 1)])
    return explorer, "" if np.isfinite(explorer.beliefs.mean).all() else "beliefs are not finite"


def add_result(stream: random.Random, explorer: Explorer, _: Path) -> Answer:
    search = explorer._state.search
    z = [0.0, 0.0] if search is None or stream.random() < 0.2 else search.points[0]
    explorer.add_result(z, _vector(stream, 3))
    return explorer, ""


def save_and_load(_: random.Random, explorer: Explorer, directory: Path) -> Answer:
    explorer.save(directory / "saved.npz")
    loaded = Explorer.load(directory / "saved.npz")
    return loaded, "" if contents(loaded) == contents(explorer) else "another state was loaded"


def tighten(stream: random.Random, explorer: Explorer, directory: Path) -> Answer:
    explorer.save(directory / "saved.npz")
    return Explorer.load(directory / "saved.npz", safeguards=_safeguards(stream)), ""


Call = Callable[[random.Random, Explorer, Path], Answer]
CALL_WEIGHTS: dict[Call, float] = {
    begin_episode: 20,
    act: 50,
    end_episode: 20,
    adapt: 8,
    discard: 1,
    control: 3,
    beliefs: 2,
    propose: 2,
    add_result: 2,
    save_and_load: 2,
    tighten: 0.5,
}
