"""The virtual machine of a scenario on a fieldbus in memory, as a test sees it."""

import json
from pathlib import Path
from typing import Any

import yaml

from drivers.ports import DrivePort
from drivers.registry import open_profile
from simulator.control import OrderTarget, carry_out
from simulator.machine import LiveMachine
from simulator.modbus.registers import load_register_map
from simulator.scenario import load_scenario
from tests.virtual_time import canbus, modbus
from tests.virtual_time.canbus import Wire
from tests.virtual_time.modbus import Gateway

CONFIG = Path(__file__).parents[2] / "config"
SCENARIO = CONFIG / "scenarios" / "max100-full.yaml"
EDS = CONFIG / "eds" / "virtual-axis.eds"
REGISTERS = CONFIG / "registers" / "virtual-high-first.yaml"
CHANNEL = "can0"
ADDRESS = ("192.0.2.1", 502)
STANDS = 1e-6  # rad/s


class VirtualMachine:
    """`wire` is its bus and what may go wrong there. The truth is read from the plant, whatever anybody believes."""

    def __init__(
        self,
        folder: Path,
        fieldbus: str = "canopen",
        scenario: Path = SCENARIO,
        speed_factor: float = 1.0,
        **bus: object,
    ) -> None:
        """`bus`: changes of this section of the profile. Its power is on."""
        canbus.install()
        modbus.install()
        self.fieldbus = fieldbus
        self._scenario, self._speed_factor = scenario, speed_factor
        self.power_on()
        name = "virtual-max100.yaml" if fieldbus == "canopen" else "virtual-max100-modbus-tcp.yaml"
        content: dict[str, Any] = yaml.safe_load((CONFIG / "drives" / name).read_text("utf-8"))
        if fieldbus == "canopen":
            line = {"interface": "socketcan", "channel": CHANNEL, "sync_period": 0.008}
            content["bus"] = {name: value for name, value in content["bus"].items() if name not in ("host", "port")}
            content["bus"] |= line | bus
            content["eds"] = str(EDS)
            silence = content["bus"]["host_timeout"]
        else:
            content["line"] |= {"host": ADDRESS[0], "port": ADDRESS[1]} | bus
            content["registers"] = str(REGISTERS)
            silence = content["line"]["watchdog"]
        self.host_timeout = float(silence)
        """s of silence of their host after which the drives stop by themselves."""
        self.profile = folder / "profile.yaml"
        self.profile.write_text(yaml.safe_dump(content), "utf-8")

    def power_on(self) -> None:
        machine = LiveMachine(load_scenario(self._scenario), 1)
        self.wire: Wire | Gateway
        if self.fieldbus == "canopen":
            self.wire = canbus.WIRES[CHANNEL] = Wire(CHANNEL, machine, EDS, self._speed_factor)
        else:
            registers = load_register_map(REGISTERS)
            self.wire = modbus.GATEWAYS[ADDRESS] = Gateway(ADDRESS, machine, EDS, registers, self._speed_factor)

    def power_off(self) -> None:
        """The drives say nothing more; the bus is there for its hosts."""
        self.wire.close()

    def open(self) -> DrivePort:
        """A port of its own, not connected; for tests without a service."""
        return open_profile(self.profile)[1]

    def order(self, order: str, **details: object) -> dict[str, Any]:
        """A fault to order, as at the control port of `sweepid drive`."""
        self.wire.look()
        line = json.dumps({"order": order, **details}).encode()
        reply: dict[str, Any] = carry_out(OrderTarget(self.wire.cabinet, self.wire), line)
        self.wire.acted()
        assert reply["ok"], reply
        return reply

    def axes(self) -> dict[str, dict[str, Any]]:
        """How the axes are at this moment."""
        return self.order("status")["axes"]

    def energised(self) -> list[str]:
        return [joint for joint, axis in self.axes().items() if axis["energised"]]

    def told(self, joint: str) -> float:
        """When its drive told its velocity last, s; on CANopen."""
        assert isinstance(self.wire, Wire)
        return self.wire.answered.get(self.wire.cabinet.nodes[joint].number, float("-inf"))

    def stands(self) -> bool:
        """No axis has energy, none moves."""
        return not any(axis["energised"] or abs(axis["velocity"]) > STANDS for axis in self.axes().values())
