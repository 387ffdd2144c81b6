"""The drive cabinet on a Modbus line: requests and times are its only inputs, responses its only outputs."""

from pathlib import Path

from pymodbus.constants import ExcCodes
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest, ReadDeviceInformationResponse
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
    WriteSingleRegisterResponse,
)

from simulator.cabinet import Cabinet
from simulator.machine import Machine
from simulator.modbus.register_map import RegisterMap
from simulator.modbus.unit import Refusal, Unit


class ModbusCabinet(Cabinet[Unit]):
    """Unit ids 1, 2, ... in the order of the machine's joints."""

    def __init__(self, machine: Machine, eds: Path, registers: RegisterMap, speed_factor: float) -> None:
        units = {
            info.joint: Unit(number, eds, registers, machine.cycle, can_move=not info.locked)
            for number, info in enumerate(machine.axes, 1)
        }
        super().__init__(machine, units, speed_factor)

    def answer(self, request: ModbusPDU, now: float) -> ModbusPDU | None:
        """The response to a request at `now`, s of a monotonic clock; None if no unit answers."""
        unit = next((unit for unit in self.nodes.values() if unit.number == request.dev_id), None)
        if unit is None:
            return None
        unit.hear(now)
        try:
            response = _carry_out(unit, request)
        except Refusal as refusal:
            response = ExceptionResponse(request.function_code, refusal.code)
        self.switch()
        return None if unit.disturbance.mute else response


def _carry_out(unit: Unit, request: ModbusPDU) -> ModbusPDU:
    match request:
        case ReadInputRegistersRequest():
            return ReadInputRegistersResponse(registers=unit.read(request.address, request.count))
        case ReadHoldingRegistersRequest():
            return ReadHoldingRegistersResponse(registers=unit.read(request.address, request.count))
        case WriteSingleRegisterRequest():
            unit.write(request.address, request.registers)
            return WriteSingleRegisterResponse(address=request.address, registers=request.registers)
        case WriteMultipleRegistersRequest():
            if not 1 <= request.count == len(request.registers) <= 123 or request.byte_count != 2 * request.count:
                raise Refusal(ExcCodes.ILLEGAL_VALUE)
            unit.write(request.address, request.registers)
            return WriteMultipleRegistersResponse(address=request.address, count=request.count)
        case ReadDeviceInformationRequest():
            return _identify(unit, request)
        case _:
            raise Refusal(ExcCodes.ILLEGAL_FUNCTION)


def _identify(unit: Unit, request: ReadDeviceInformationRequest) -> ModbusPDU:
    """Read codes: 1 basic and 2 regular objects, 3 all, 4 a single one."""
    objects = unit.identification()
    match request.read_code:
        case 1 | 2:
            chosen = {number: text for number, text in objects.items() if request.object_id <= number < 0x80}
        case 3:
            chosen = {number: text for number, text in objects.items() if request.object_id <= number}
        case 4:
            chosen = {number: text for number, text in objects.items() if request.object_id == number}
        case _:
            raise Refusal(ExcCodes.ILLEGAL_VALUE)
    if not chosen:
        raise Refusal(ExcCodes.ILLEGAL_ADDRESS)
    return ReadDeviceInformationResponse(read_code=request.read_code, information=chosen)
