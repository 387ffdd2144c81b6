"""Every adapter on every bus does what `drivers.contract` asks of a `DrivePort`."""

from drivers.contract import DrivePortSuite, NoiseSuite


class TestDrivePort(DrivePortSuite):
    """Over `virtual` of conftest.py."""


class TestNoise(NoiseSuite):
    """The same."""
