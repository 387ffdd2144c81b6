import struct

import pytest

from simulator.canopen.pdo import Pdo, process_data
from simulator.drive.dictionary import Abort, AbortCode, Dictionary

INVALID = 1 << 31


@pytest.fixture
def pdos(dictionary: Dictionary) -> tuple[list[Pdo], list[Pdo]]:
    return process_data(dictionary)


def write(dictionary: Dictionary, index: int, subindex: int, value: int) -> None:
    dictionary.download(index, subindex, struct.pack("<B" if subindex == 0 else "<I", value))


def test_default_mapping(dictionary: Dictionary, pdos: tuple[list[Pdo], list[Pdo]]) -> None:
    (receive,), (first, second) = pdos
    dictionary[0x6041, 0], dictionary[0x606C, 0], dictionary[0x6077, 0] = 0x0637, -100_000, -7
    dictionary[0x6064, 0], dictionary[0x2120, 1] = -5, 6
    assert (first.cob_id, first.pack()) == (0x183, struct.pack("<Hih", 0x0637, -100_000, -7))
    assert (second.cob_id, second.pack()) == (0x283, struct.pack("<iI", -5, 6))
    assert receive.cob_id == 0x203
    assert receive.unpack(b"\x0f\0\1\0\0\0") == [((0x6040, 0), b"\x0f\0"), ((0x60FF, 0), b"\1\0\0\0")]
    assert receive.unpack(b"\x0f\0\1\0") == []


def test_remapped_by_the_usual_procedure(dictionary: Dictionary, pdos: tuple[list[Pdo], list[Pdo]]) -> None:
    _, (first, _) = pdos
    write(dictionary, 0x1800, 1, 0x183 | INVALID)
    assert not first.valid
    write(dictionary, 0x1A00, 0, 0)
    write(dictionary, 0x1A00, 1, 0x60640020)
    write(dictionary, 0x1A00, 2, 0x60610008)
    write(dictionary, 0x1A00, 0, 2)
    write(dictionary, 0x1800, 1, 0x190)
    dictionary[0x6064, 0], dictionary[0x6061, 0] = 77, 9
    assert (first.valid, first.cob_id, first.pack()) == (True, 0x190, struct.pack("<ib", 77, 9))


@pytest.mark.parametrize(
    ("writes", "code"),
    [
        ([(0x1A00, 0, 0)], AbortCode.STATE),  # still valid
        ([(0x1800, 1, 0x184)], AbortCode.STATE),  # another COB-ID while valid
        ([(0x1800, 1, INVALID), (0x1800, 1, 0x80)], AbortCode.VALUE),
        ([(0x1800, 1, INVALID), (0x1A00, 1, 0x60640020)], AbortCode.STATE),  # sub-index 0 not 0
        ([(0x1800, 1, INVALID), (0x1A00, 0, 0), (0x1A00, 1, 0x70000010)], AbortCode.NO_OBJECT),
        ([(0x1800, 1, INVALID), (0x1A00, 0, 0), (0x1A00, 1, 0x60640010)], AbortCode.NOT_MAPPABLE),  # wrong length
        ([(0x1800, 1, INVALID), (0x1A00, 0, 0), (0x1A00, 1, 0x60720010)], AbortCode.NOT_MAPPABLE),
        ([(0x1400, 1, INVALID), (0x1600, 0, 0), (0x1600, 1, 0x60410010)], AbortCode.NOT_MAPPABLE),  # read only
        (
            [
                (0x1800, 1, INVALID),
                (0x1A00, 0, 0),
                (0x1A00, 1, 0x60640020),
                (0x1A00, 2, 0x606C0020),
                (0x1A00, 3, 0x60770010),
                (0x1A00, 0, 3),
            ],
            AbortCode.PDO_LENGTH,
        ),
    ],
)
def test_wrong_configuration_is_refused(
    dictionary: Dictionary,
    pdos: tuple[list[Pdo], list[Pdo]],
    writes: list[tuple[int, int, int]],
    code: AbortCode,
) -> None:
    *before, last = writes
    for step in before:
        write(dictionary, *step)
    with pytest.raises(Abort) as refused:
        write(dictionary, *last)
    assert refused.value.code is code
