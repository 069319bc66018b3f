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
        Kind("kills", kills.attempt, 300, 120),
        Kind("mutated files", mutations.attempt, 2400, 20),
        Kind("signals", signals.attempt, 100, 120),
        Kind("two writers", writers.attempt, 60, 120),
        Kind("disks", disks.attempt, 200, 120),
        Kind("faulty environments", environments.attempt, 80, 90),
        Kind("runtime calls", runtime_calls.attempt, 510, 120),
        Kind("wrong command lines", command_lines.attempt, 300, 90),
    )
}
