"""The faults to order of a virtual machine: what makes each, what takes it back, and the adapters that can meet it.

`tests/system/test_fault_table.py` measures them one by one and makes docs/reference/faults.md of it; `tests/soak` takes
those that it names, at random moments.
"""

from dataclasses import dataclass

AXIS, OTHER = "joint_1", "joint_3"

Order = tuple[str, dict[str, object]]
"""Of the control port: name and fields."""


@dataclass(frozen=True)
class Adapter:
    """How the machine is reached, and who makes the sweep; `axes`: that turn, those of one sweep at once."""

    name: str
    fieldbus: str
    modes: str
    axes: tuple[str, ...] = (AXIS,)


OWN_SWEEP = Adapter("CANopen, drive's own sweep", "canopen", "drive_side")
STREAMED = Adapter("CANopen, streamed sweep", "canopen", "host_streamed")
TOGETHER = Adapter("CANopen, simultaneous sweep", "canopen", "host_streamed", ("joint_2", AXIS))
MODBUS = Adapter("Modbus TCP", "modbus-tcp", "drive_side")
ADAPTERS = (OWN_SWEEP, STREAMED, TOGETHER, MODBUS)
BY_HOST = (STREAMED, TOGETHER)
CANOPEN = (OWN_SWEEP, *BY_HOST)


@dataclass(frozen=True)
class Fault:
    make: Order
    undo: tuple[Order, ...] = ()
    adapters: tuple[Adapter, ...] = ADAPTERS
    before_connecting: bool = False


def _axis(order: str, joint: str = AXIS, **fields: object) -> Order:
    return order, {"joint": joint, **fields}


def _switched(order: str, joint: str = AXIS, adapters: tuple[Adapter, ...] = ADAPTERS) -> Fault:
    return Fault(_axis(order, joint, on=True), (_axis(order, joint, on=False),), adapters)


_SWAP = _axis("swap", **{"with": "joint_2"})
FAULTS = {
    "drive fault": Fault(_axis("fault", code=0x7305)),
    "fault of an axis that stands": Fault(_axis("fault", OTHER, code=0x4310)),
    "EMCY without a fault state": Fault(_axis("emcy", code=0x4210), adapters=CANOPEN),
    "lost PDO": Fault(_axis("drop_tpdos", count=1), (_axis("drop_tpdos", count=0),), BY_HOST),
    "duplicated PDOs": Fault(_axis("duplicate_tpdos", count=20), (_axis("duplicate_tpdos", count=0),), BY_HOST),
    "late PDOs": Fault(_axis("delay_tpdos", count=3, cycles=2), adapters=BY_HOST),
    "bus-off": Fault(("bus_off", {}), (("bus_on", {}),), CANOPEN),
    "silent node": _switched("silence"),
    "silent node that stands": _switched("silence", OTHER),
    "frozen sample counter": _switched("freeze_counter", adapters=BY_HOST),
    "limit switch": _switched("limit"),
    "emergency stop": Fault(("emergency_stop", {"on": True}), (("emergency_stop", {"on": False}),)),
    "small encoder glitch": Fault(_axis("glitch", revolutions=0.05)),
    "large encoder glitch": Fault(_axis("glitch", revolutions=50.0)),
    "torque saturation": Fault(_axis("saturate", torque_permille=5), (_axis("saturate", torque_permille=None),)),
    "reboot of the node": Fault(_axis("reboot")),
    "wrong identity": Fault(
        _axis("identity", product=0x0999), (_axis("identity", product=0x0402),), before_connecting=True
    ),
    "swapped addresses": Fault(_SWAP, (_SWAP,), before_connecting=True),
}
