"""SDO and PDOs of a foreign drive, asked by the `canopen` package: CiA 301 is enforced."""

import pytest

from tests.unit.simulator.foreign.master import PATIENCE, Cycle, Master

INVALID = 1 << 31
STATE, NOT_MAPPABLE, TOO_LONG, NO_OBJECT, VALUE = 0x08000022, 0x06040041, 0x06040042, 0x06020000, 0x06090030


def test_a_valid_pdo_keeps_its_identifier_and_its_mapping(master: Master) -> None:
    master.refused(STATE, 0x1800, 1, 0x40000000 | 0x1F1, 4)
    master.refused(STATE, 0x1A00, 0, 0, 1)
    master.refused(STATE, 0x1A00, 1, 0x60640020, 4)
    master.refused(STATE, 0x1800, 3, 100, 2)


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


@pytest.mark.parametrize("kind", [0, 241, 252, 253])
def test_transmission_types_that_the_drive_does_not_have(master: Master, kind: int) -> None:
    master.refused(VALUE, 0x1800, 2, kind, 1)


@pytest.mark.parametrize("identifier", [0x000, 0x05, 0x101, 0x581, 0x601, 0x701, 1 << 29 | 0x181])
def test_reserved_and_extended_identifiers(master: Master, identifier: int) -> None:
    master.write(0x1800, 1, INVALID | 0x181, 4)
    master.refused(VALUE, 0x1800, 1, identifier, 4)


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


def test_one_host_is_watched_by_one_consumer(master: Master) -> None:
    master.write(0x1016, 1, 127 << 16 | 1000, 4)
    master.refused(0x06040043, 0x1016, 2, 127 << 16 | 500, 4)
    master.write(0x1016, 2, 126 << 16 | 500, 4)
