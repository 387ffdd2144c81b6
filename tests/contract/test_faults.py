"""Every adapter on every bus does what `drivers.contract` asks where the drive, the bus or the axis misbehaves."""

from drivers.contract import FaultSuite


class TestFaults(FaultSuite):
    """Over `virtual` of conftest.py."""
