"""Which sweeps of an imported campaign share an estimate revision.

All sweeps of an imported campaign are recorded before the first of them is identified. The estimate after the
first 17 of 900 sweeps is of no use, so not every sweep needs a revision of its own. Which sweeps have one depends only
the number of sweeps, so it is the same after a restart.
"""

from collections.abc import Sequence

from service.store.documents import SweepDocument, SweepState

MOST_REVISIONS = 60  # points of a convergence chart; with 900 sweeps their estimates take 13 s of processor time


def sweeps_a_revision(count: int) -> int:
    """Number of sweeps per revision in an imported campaign of `count` sweeps; the last revision may have fewer."""
    return -(-count // MOST_REVISIONS)


def open_groups(sweeps: Sequence[SweepDocument]) -> list[tuple[SweepDocument, ...]]:
    """The sweeps of an imported campaign that wait for identification, in the groups that share a revision."""
    size = sweeps_a_revision(len(sweeps))
    groups: dict[int, list[SweepDocument]] = {}
    for sweep in sweeps:
        if sweep.state is SweepState.RECORDED:
            groups.setdefault((sweep.number - 1) // size, []).append(sweep)
    return [tuple(group) for _, group in sorted(groups.items())]
