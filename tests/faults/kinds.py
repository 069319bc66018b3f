"""The kinds of faults, and how many of each are a full campaign."""

from faults import disks, environments, kills, mutations, runtime_calls, signals, writers
from faults.table import Kind

KINDS = {
    kind.name: kind
    for kind in (
        Kind("kills", kills.attempt, 400, 120),
        Kind("mutated files", mutations.attempt, 2000, 30),
        Kind("signals", signals.attempt, 120, 120),
        Kind("two writers", writers.attempt, 60, 120),
        Kind("disks", disks.attempt, 300, 120),
        Kind("runtime calls", runtime_calls.attempt, 500, 60),
        Kind("faulty environments", environments.attempt, 120, 60),
    )
}
