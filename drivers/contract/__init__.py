"""Tests that every `drivers.ports.DrivePort` must pass, usable for any adapter: classes over a fixture `virtual`.

Needs pytest and pytest-asyncio (``sweepid[contract]``). `DrivePortSuite`, `FaultSuite` and `NoiseSuite` become tests
of a module by subclasses whose names begin with ``Test``. The module provides the fixture `virtual`, a
`MachineUnderTest`. Tests of functions that the machine's `Bench` lacks are skipped with the reason.
"""

import pytest

# registered before the import, so that failed asserts show their values
pytest.register_assert_rewrite(*(f"drivers.contract.{name}" for name in ("bench", "faults", "motion")))

from drivers.contract.bench import Bench, MachineUnderTest, lacking, needs  # noqa: E402
from drivers.contract.motion import DrivePortSuite, FaultSuite, NoiseSuite  # noqa: E402

__all__ = ["Bench", "DrivePortSuite", "FaultSuite", "MachineUnderTest", "NoiseSuite", "lacking", "needs"]
