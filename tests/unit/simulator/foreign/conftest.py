"""A host that is not ours before foreign drives: the `canopen` package."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import canopen
import pytest

from tests.foreign_bench import SCENARIO, Foreign, bench
from tests.unit.simulator.foreign.master import Master

RIGID = SCENARIO.with_stem("max100-rigid")


@contextmanager
def mastered(foreign: Foreign, joint: str = "joint_1") -> Iterator[Master]:
    """A master on the cabinet's bus, the drive of `joint` just booted."""
    network: Any = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05
    network.connect(**foreign.bus)
    try:
        yield Master(network, foreign, joint)
    finally:
        network.disconnect()
        foreign.order("emergency_stop", on=True)
        foreign.order("emergency_stop", on=False)


@pytest.fixture(scope="module")
def foreign() -> Iterator[Foreign]:
    """One cabinet of plain drives for a module's tests, without noise and cogging."""
    with bench(scenario=RIGID) as foreign:
        yield foreign


@pytest.fixture
def master(foreign: Foreign) -> Iterator[Master]:
    with mastered(foreign) as master:
        yield master
