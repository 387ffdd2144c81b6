"""The SDO server of a foreign drive, asked by the `canopen` package: what its file lacks is not there."""

import math

import pytest
from canopen.sdo.exceptions import SdoAbortedError

from tests.unit.simulator.foreign.master import Master


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
