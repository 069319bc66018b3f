"""The kinds of faults, and how many of each are a full campaign."""

from faults import (
    disks,
    kills,
    mutations,
    runtime_calls,
)
from faults.table import Kind

KINDS = {
    kind.name: kind
    for kind in (
        Kind("kills", kills.attempt, 300, 112),
        Kind("mutated files", mutations.attempt, 2400, 12),
        Kind("disks", disks.attempt, 200, 112),
        Kind("runtime calls", runtime_calls.attempt, 510, 112),
    )
}
