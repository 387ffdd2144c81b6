import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from toy_drive import DISABLED, READY, Server

from drivers.contract import Bench, DrivePortSuite, FaultSuite, NoiseSuite
from drivers.ports import DrivePort, SweepMode
from drivers.registry import open_drive

GEAR = 100.0
BENCH = Bench(
    modes=frozenset({SweepMode.DRIVE_SIDE}),
    orders=frozenset({"fault", "emergency_stop", "silence", "identity"}),
    axis="turntable",
    position_limits=(-3.0, 3.0),
    velocity_limit=1.0,
    effort=1000.0,
    slow_effort=(100.0, 110.0),  # 100 N m of dry friction, and a little of viscous
    least_effort=50.0,
)


class Toy:
    """See `drivers.contract.Machine`."""

    bench = BENCH

    def __init__(self, server: Server) -> None:
        self.drive = server.drive
        axis = {
            "joint": BENCH.axis,
            "port": server.server_address[1],
            "identity": {"vendor": 0x5459, "product": 1, "revision": 1},
            "gear_ratio": GEAR,
            "rated_torque": 10.0,
            "position_limits": BENCH.position_limits,
            "velocity_limit": BENCH.velocity_limit,
            "effort_limit": 1500.0,
            "acceleration": 1.0,
            "quick_stop_deceleration": 4.0,
            "standstill_velocity": 1e-3,
        }
        self.profile: Mapping[str, object] = {"adapter": "toy", "host": "127.0.0.1", "axes": [axis]}

    def open(self) -> DrivePort:
        return open_drive(self.profile, Path())

    def truth(self, joint: str) -> Mapping[str, Any]:
        with self.drive.lock:
            self.drive.run_on()
            position, velocity = self.drive.position / GEAR, self.drive.velocity / GEAR
            return {"position": position, "velocity": velocity, "fault": self.drive.error}

    def energised(self) -> list[str]:
        with self.drive.lock:
            self.drive.run_on()
            off = (DISABLED, READY, 0x08)
            return [] if self.drive.state in off else [BENCH.axis]

    def order(self, order: str, **fields: Any) -> Mapping[str, Any]:
        drive = self.drive
        with drive.lock:
            drive.run_on()
            if order == "fault" and "at_sample" in fields:
                drive.fault_at = (fields["at_sample"], fields["code"])
            elif order == "fault":
                drive.fail(fields["code"])
            elif order == "silence":
                drive.silent = fields["on"]
            elif order == "identity":
                drive.who["product"] = fields["product"]
            elif order == "emergency_stop":
                drive.pressed = fields["on"]
                if drive.pressed:
                    drive.fail(0x9000)
        return {}

    def recover(self) -> None:
        self.order("silence", on=False)
        self.order("emergency_stop", on=False)


@pytest.fixture(scope="module")
def virtual() -> Iterator[Toy]:
    with Server() as server:
        thread = threading.Thread(target=server.serve_forever, name="toy drive")
        thread.start()
        yield Toy(server)
        server.shutdown()
        thread.join()


class TestDrivePort(DrivePortSuite):
    pass


class TestFaults(FaultSuite):
    pass


class TestNoise(NoiseSuite):
    pass
