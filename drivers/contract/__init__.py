"""What every `drivers.ports.DrivePort` must do, as tests that any adapter can run: classes over a fixture `virtual`.

Needs pytest and pytest-asyncio (``sweepid[contract]``). `DrivePortSuite`, `FaultSuite` and `NoiseSuite` become tests of
a module by subclasses whose names begin with ``Test``; the module gives the fixture `virtual`, a `Machine`. What the
machine's `Bench` does not have is skipped with the reason.
"""

import pytest

# before they are imported, or their asserts would tell nothing but that they failed
pytest.register_assert_rewrite(
    *(f"drivers.contract.{name}" for name in ("bench", "faults", "motion", "noise", "suite"))
)

from drivers.contract.bench import Bench, Machine  # noqa: E402
from drivers.contract.faults import FaultSuite  # noqa: E402
from drivers.contract.motion import DrivePortSuite  # noqa: E402
from drivers.contract.needs import lacking, needs  # noqa: E402
from drivers.contract.noise import NoiseSuite  # noqa: E402

__all__ = ["Bench", "DrivePortSuite", "FaultSuite", "Machine", "NoiseSuite", "lacking", "needs"]
