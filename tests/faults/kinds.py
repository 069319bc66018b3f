"""The kinds of faults, and how many of each are a full campaign."""

from faults import (
    command_lines,
    disks,
    environments,
    kills,
    mutations,
    runtime_calls,
    signals,
    writers,
)
from faults.table import Kind

KINDS = {
    kind.name: kind
    for kind in (
        Kind("kills", kills.attempt, 400, 120),
        Kind("mutated files", mutations.attempt, 3000, 60),
        Kind("signals", signals.attempt, 120, 120),
        Kind("two writers", writers.attempt, 60, 120),
        Kind("disks", disks.attempt, 300, 120),
        Kind("faulty environments", environments.attempt, 120, 90),
        Kind("runtime calls", runtime_calls.attempt, 550, 120),
        Kind("wrong command lines", command_lines.attempt, 400, 90),
    )
}
