"""The kinds of faults, and how many of each are a full campaign."""

from faults import (
    command_lines,
    disks,
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
        Kind("kills", kills.attempt, 300, 112),
        Kind("mutated files", mutations.attempt, 2400, 12),
        Kind("signals", signals.attempt, 100, 112),
        Kind("two writers", writers.attempt, 60, 112),
        Kind("disks", disks.attempt, 200, 112),
        Kind("runtime calls", runtime_calls.attempt, 510, 112),
        Kind("wrong command lines", command_lines.attempt, 300, 90),
    )
}
