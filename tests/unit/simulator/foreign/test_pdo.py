"""SDO and PDOs of a foreign drive, asked by the `canopen` package: CiA 301 is enforced."""

import math

import pytest
from canopen.sdo.exceptions import SdoAbortedError

from tests.unit.simulator.foreign.master import PATIENCE, Cycle, Master

INVALID = 1 << 31
STATE, NOT_MAPPABLE, TOO_LONG, NO_OBJECT, VALUE = 0x08000022, 0x06040041, 0x06040042, 0x06020000, 0x06090030


def test_a_valid_pdo_keeps_its_identifier_and_its_mapping(master: Master) -> None:
    master.refused(STATE, 0x1800, 1, 0x40000000 | 0x1F1, 4)
    master.refused(STATE, 0x1A00, 0, 0, 1)
    master.refused(STATE, 0x1A00, 1, 0x60640020, 4)
    master.refused(STATE, 0x1800, 3, 100, 2)


def test_a_mapping_changes_only_while_its_number_is_zero(master: Master) -> None:
    master.write(0x1800, 1, INVALID | 0x40000181, 4)
    master.refused(STATE, 0x1A00, 1, 0x60640020, 4)
    master.write(0x1A00, 0, 0, 1)
    master.write(0x1A00, 1, 0x60640020, 4)
    master.write(0x1A00, 0, 1, 1)
    master.write(0x1800, 1, 0x40000181, 4)


@pytest.mark.parametrize(
    ("entry", "code"),
    [
        (0x60650020, NOT_MAPPABLE),  # PDOMapping=0
        (0x60640010, NOT_MAPPABLE),  # a wrong length
        (0x60400010, NOT_MAPPABLE),  # rww: no actual value
        (0x00050008, NO_OBJECT),  # a dummy: in RPDOs alone
        (0x60F40020, NO_OBJECT),
        (0x60640120, 0x06090011),
    ],
)
def test_what_is_no_actual_value_cannot_be_mapped(master: Master, entry: int, code: int) -> None:
    master.write(0x1801, 1, INVALID | 0x40000281, 4)
    master.write(0x1A01, 0, 0, 1)
    master.refused(code, 0x1A01, 1, entry, 4)


def test_set_points_and_dummies_fit_into_an_rpdo(master: Master) -> None:
    master.write(0x1401, 1, INVALID | 0x301, 4)
    master.write(0x1601, 0, 0, 1)
    master.refused(NOT_MAPPABLE, 0x1601, 1, 0x60410010, 4)
    for sub, entry in enumerate((0x00070020, 0x60FF0020), 1):
        master.write(0x1601, sub, entry, 4)
    master.write(0x1601, 0, 2, 1)


def test_no_more_than_eight_bytes(master: Master) -> None:
    master.write(0x1A02, 0, 0, 1)
    for sub, entry in enumerate((0x60640020, 0x606C0020, 0x60770010), 1):
        master.write(0x1A02, sub, entry, 4)
    master.refused(TOO_LONG, 0x1A02, 0, 3, 1)
    master.write(0x1A02, 0, 2, 1)
    master.refused(0x06090031, 0x1A02, 0, 9, 1)


@pytest.mark.parametrize("kind", [0, 241, 252, 253])
def test_transmission_types_that_the_drive_does_not_have(master: Master, kind: int) -> None:
    master.refused(VALUE, 0x1800, 2, kind, 1)


@pytest.mark.parametrize("identifier", [0x000, 0x05, 0x101, 0x581, 0x601, 0x701, 1 << 29 | 0x181])
def test_reserved_and_extended_identifiers(master: Master, identifier: int) -> None:
    master.write(0x1800, 1, INVALID | 0x181, 4)
    master.refused(VALUE, 0x1800, 1, identifier, 4)


def test_every_third_sync(master: Master) -> None:
    cycle = Cycle(master, 0x60FF0000)
    master.write(0x1800, 2, 3, 1)
    times = [cycle.sync() or cycle.state.timestamp for _ in range(9)]
    assert len({time for time in times if time is not None}) == 3


def test_a_synchronous_set_point_waits_for_sync(master: Master) -> None:
    cycle = Cycle(master, 0x60FF0000)
    cycle.rpdo[0].raw, cycle.rpdo[1].raw = 6, 4711
    cycle.rpdo.transmit()
    assert master.number(0x60FF) == 0
    cycle.sync()
    assert master.number(0x60FF) == 4711
    assert cycle.state[0].raw & 0x6F == 0x40  # sampled before the set-point acted
    cycle.sync()
    assert cycle.state[0].raw & 0x6F == 0x21


def test_an_event_is_told_at_once_and_needs_no_sync(master: Master) -> None:
    node = master.node
    node.tpdo.read()
    node.rpdo.read()
    state = master.map("tpdo", 1, 0x60410000, sync=255)
    node.nmt.state = "OPERATIONAL"
    assert state.wait_for_reception(PATIENCE) is not None
    node.rpdo[1][0].raw = 6
    node.rpdo[1].transmit()
    master.settle(lambda: state[0].raw & 0x6F == 0x21)


def test_a_frame_of_the_wrong_length_is_told(master: Master) -> None:
    cycle = Cycle(master, 0x60FF0000)
    master.network.send_message(cycle.rpdo.cob_id, b"\x06\x00")
    master.settle(lambda: 0x8210 in master.emergencies)
    master.network.send_message(cycle.rpdo.cob_id, bytes(8))
    master.settle(lambda: 0x8220 in master.emergencies)


def test_no_process_data_before_operational(master: Master) -> None:
    cycle = Cycle(master, 0x60FF0000)
    master.node.nmt.state = "PRE-OPERATIONAL"
    cycle.rpdo[0].raw = 6
    cycle.rpdo.transmit()
    master.network.sync.transmit()
    assert master.number(0x6041) & 0x6F == 0x40
    assert cycle.place.timestamp is None


def test_every_object_of_the_file_can_be_read_and_no_other(master: Master) -> None:
    for entry in master.node.object_dictionary.values():
        for variable in [entry] if not hasattr(entry, "values") else entry.values():
            if variable.index >= 0x1000:
                data = master.read(variable.index, variable.subindex)
                assert variable.data_type == 9 or 8 * len(data) == len(variable)
    for index, subindex, code in (
        (0x2100, 1, 0x06020000),  # the virtual drive's measuring function
        (0x2120, 1, 0x06020000),  # and its counter
        (0x6075, 0, 0x06020000),
        (0x0005, 0, 0x06020000),  # a data type
        (0x6077, 1, 0x06090011),
        (0x1018, 5, 0x06090011),
    ):
        with pytest.raises(SdoAbortedError) as caught:
            master.read(index, subindex)
        assert caught.value.code == code


def test_identity_and_a_name_longer_than_four_bytes(master: Master) -> None:
    assert [master.number(0x1018, sub) for sub in (1, 2, 3)] == [0x5357, 0x0410, 0x00010000]
    assert master.number(0x1018, 4) != 0
    assert master.read(0x1008) == b"plain servo drive"


@pytest.mark.parametrize(
    ("code", "index", "subindex", "value", "size"),
    [
        (0x06020000, 0x6073, 0, 1000, 2),
        (0x06090011, 0x607D, 3, 0, 4),
        (0x06010002, 0x6041, 0, 0, 2),
        (0x06010002, 0x1018, 4, 7, 4),
        (0x06070010, 0x60FF, 0, 0, 2),
        (0x06070010, 0x6040, 0, 0, 4),
        (0x06090031, 0x6007, 0, 4, 2),
        (0x06090032, 0x6007, 0, -1, 2),
        (0x06090032, 0x60C2, 1, 0, 1),
        (0x06090031, 0x60C2, 2, -1, 1),
        (0x06090030, 0x605A, 0, 4, 2),
        (0x06090030, 0x1003, 0, 1, 1),
    ],
)
def test_what_cannot_be_written(master: Master, code: int, index: int, subindex: int, value: int, size: int) -> None:
    master.refused(code, index, subindex, value, size)


def test_a_value_that_is_taken_is_read_back_and_lost_with_a_reset(master: Master) -> None:
    master.write(0x6085, 0, 123456, 4)
    assert master.number(0x6085) == 123456
    master.reset()
    assert master.number(0x6085) != 123456


def test_one_host_is_watched_by_one_consumer(master: Master) -> None:
    master.write(0x1016, 1, 127 << 16 | 1000, 4)
    master.refused(0x06040043, 0x1016, 2, 127 << 16 | 500, 4)
    master.write(0x1016, 2, 126 << 16 | 500, 4)


def test_the_motor_is_in_the_dictionary(master: Master) -> None:
    """Joint 1 of the machine: 17.544 N m rated, gear 171, 1.9 rad/s, +-2.96 rad; 131072 increments a revolution."""
    turns = 171 / math.tau
    assert master.number(0x6076) == pytest.approx(17544, abs=1)
    assert master.number(0x6080) == pytest.approx(1.9 * turns * 60, abs=1)  # rev/min
    assert master.number(0x607F) == pytest.approx(1.9 * turns * 131072, abs=1)
    window = [master.number(0x607D, sub) for sub in (1, 2)]
    assert window == pytest.approx([-2.96 * turns * 131072, 2.96 * turns * 131072], abs=1)
