"""Checks whether a machine injects torque noise, and how it refuses if it does not."""

import pytest

from drivers.contract.bench import Machine, consume
from drivers.contract.requirements import needs
from drivers.contract.suite import Suite
from drivers.errors import NotReady
from drivers.ports import AxisState, DrivePort


class NoiseSuite(Suite):
    async def test_the_capability_is_reported(self, port: DrivePort, virtual: Machine) -> None:
        assert port.capabilities.torque_injection is virtual.bench.injects

    @needs(injects=False)
    async def test_noise_is_refused_before_moving_where_there_is_none(
        self, port: DrivePort, virtual: Machine, axis: str
    ) -> None:
        await port.enable(axis)
        before = virtual.truth(axis)["position"]
        with pytest.raises(NotReady, match="torque noise is not supported by this drive"):
            await consume(port, await virtual.bench.noise(port))
        assert virtual.truth(axis)["position"] == pytest.approx(before, abs=1e-4)
        assert (await port.status())[axis].state is AxisState.ENABLED
