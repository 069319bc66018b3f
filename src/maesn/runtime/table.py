"""What a robot gets and must give, as a table for a person to check."""

from collections.abc import Iterator
from itertools import groupby

import numpy as np

from maesn.runtime.actuators import Actuators
from maesn.runtime.arrays import FloatArray
from maesn.runtime.exported import ExportedPolicy
from maesn.runtime.sensors import Sensors

_FEW = 30  # components that have a row each; of more, neighbours share one
_ABOUT = ("family", "method", "iteration", "task", "maesn_version")


def facts(exported: ExportedPolicy) -> list[tuple[str, str]]:
    """Return the rows of the table: what it is about, and the value in the simulation."""
    said = exported.description
    rows = [("policy", ", ".join(f"{name} {said[name]}" for name in _ABOUT if name in said))]
    rows += [*_observations(exported.sensors), *_controls(exported.actuators)]
    steps, period = int(said["horizon"]), float(said["control_period"])
    rows.append(("control period", f"{period:.6g} s"))
    rows.append(("episode", f"{steps} steps, {steps * period:.6g} s"))
    kinds = {True: f"drawn, std {_numbers(exported.policy.std)}", False: "the mean"}
    rows += [
        (f"actions to {purpose}", kinds[noisy]) for purpose, noisy in exported.is_noisy.items()
    ]
    return [*rows, *_latent(exported), *_reward(exported)]


def _latent(exported: ExportedPolicy) -> Iterator[tuple[str, str]]:
    if exported.search is None:
        start = f"mean {_numbers(exported.start.mean)}, std {_numbers(exported.start.std)}"
        yield "z starts at", f"{start}, after {exported.start_update} updates"
    else:
        number = len(exported.search.prior.latents)
        yield "z", f"chosen by the search, whose archive has {number} latents"


def _reward(exported: ExportedPolicy) -> Iterator[tuple[str, str]]:
    if exported.search is None:
        yield "reward", "of any scale: an update standardises it"
        return
    low, high = exported.search.model.explained()
    kind = exported.description.get("reward", "that of the prior")
    yield "reward", f"{kind}; the search knows returns from {low:.6g} to {high:.6g}"


def _observations(sensors: Sensors) -> Iterator[tuple[str, str]]:
    """Yield a row for each component of an observation, or for neighbours of one kind."""
    limits = _limits("clip", sensors.lower, sensors.upper)
    components = list(zip(sensors.names, limits, strict=True))

    def kind(index: int) -> object:
        name, limit = components[index]
        return index if len(components) <= _FEW else (name.partition("[")[0], limit)

    for _, group in groupby(range(len(components)), key=kind):
        places = list(group)
        ends = dict.fromkeys((places[0], places[-1]))  # one, or two
        names = dict.fromkeys(components[end][0] for end in ends)
        place = "-".join(map(str, ends))
        yield f"observation {place}", _joined(" ... ".join(names), components[places[0]][1])


def _controls(actuators: Actuators) -> Iterator[tuple[str, str]]:
    for index, limit in enumerate(_limits("limits", actuators.lower, actuators.upper)):
        shift = f"{actuators.offset[index]:.6g} + " if actuators.offset[index] else ""
        linear = f"{shift}{actuators.scale[index]:.6g} * action"
        yield f"control {index}", _joined(actuators.names[index], linear, limit or "no limits")


def _joined(*parts: str) -> str:
    return ", ".join(filter(None, parts))


def _limits(word: str, lower: FloatArray, upper: FloatArray) -> list[str]:
    pairs = zip(lower, upper, strict=True)
    limited = np.isfinite(lower) | np.isfinite(upper)
    texts = (f"{word} {low:.6g} to {high:.6g}" for low, high in pairs)
    return [text if limit else "" for text, limit in zip(texts, limited, strict=True)]


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{value:.4g}" for value in values)
