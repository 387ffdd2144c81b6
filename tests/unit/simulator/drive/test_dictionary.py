import struct

import pytest

from simulator.drive.dictionary import Abort, AbortCode, Dictionary


@pytest.mark.parametrize(
    ("key", "data", "code"),
    [
        ((0x7000, 0), b"\0", AbortCode.NO_OBJECT),
        ((0x2101, 17), bytes(8), AbortCode.NO_SUBINDEX),
        ((0x6041, 0), b"\0\0", AbortCode.READ_ONLY),
        ((0x1000, 0), bytes(4), AbortCode.READ_ONLY),
        ((0x6040, 0), b"\0", AbortCode.TOO_SHORT),
        ((0x6040, 0), b"\0\0\0", AbortCode.TOO_LONG),
        ((0x605A, 0), struct.pack("<h", 7), AbortCode.TOO_HIGH),
        ((0x605A, 0), struct.pack("<h", -1), AbortCode.TOO_LOW),
        ((0x6072, 0), struct.pack("<H", 5001), AbortCode.TOO_HIGH),
        ((0x6085, 0), bytes(4), AbortCode.TOO_LOW),
        ((0x2100, 9), struct.pack("<H", 17), AbortCode.TOO_HIGH),
    ],
)
def test_refuses_with_the_code_of_the_standard_and_keeps_the_value(
    dictionary: Dictionary, key: tuple[int, int], data: bytes, code: AbortCode
) -> None:
    known = key in dictionary
    before = dictionary[key] if known else None
    with pytest.raises(Abort) as refused:
        dictionary.download(*key, data)
    assert refused.value.code is code
    assert not known or dictionary[key] == before


def test_values_go_in_and_out_as_they_lie_on_the_wire(dictionary: Dictionary) -> None:
    dictionary.download(0x607A, 0, struct.pack("<i", -123456))
    assert dictionary[0x607A, 0] == -123456
    assert dictionary.upload(0x607A, 0) == struct.pack("<i", -123456)
    dictionary.download(0x2100, 4, struct.pack("<d", -17.25))
    assert dictionary[0x2100, 4] == -17.25
    assert dictionary.upload(0x1008, 0) == b"sweepid virtual axis"
    assert dictionary[0x1800, 1] == 0x40000183  # $NODEID
    assert dictionary[0x60A9, 0] == 0xFDB44700


def test_a_hook_may_refuse(dictionary: Dictionary) -> None:
    def refuse(value: int) -> None:
        if value > 5:
            raise Abort(AbortCode.VALUE)

    dictionary.on_download((0x1017, 0), refuse)
    dictionary.download(0x1017, 0, b"\5\0")
    with pytest.raises(Abort):
        dictionary.download(0x1017, 0, b"\6\0")
    assert dictionary[0x1017, 0] == 5
    dictionary.restore()
    assert dictionary[0x1017, 0] == 0
