"""The SDO server and the PDOs of the virtual drive; and any frames at all."""

import binascii
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from simulator import Scenario
from simulator.canopen.line import CanopenCabinet
from simulator.canopen.node import SdoServer
from simulator.canopen.pdo import Frame, PdoChannel, process_data
from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort
from simulator.drive.virtual_axis import VirtualAxis
from simulator.machine import LiveMachine

TRACE = bytes(range(256)) * 8


@pytest.fixture
def server(dictionary: ObjectDictionary) -> SdoServer:
    dictionary.on_upload((0x2110, 3), lambda: TRACE)
    return SdoServer(dictionary)


def head(command: int, index: int, subindex: int) -> bytes:
    return struct.pack("<BHB", command, index, subindex)


def abort(index: int, subindex: int, code: AbortCode) -> list[bytes]:
    return [struct.pack("<BHBI", 0x80, index, subindex, code)]


def test_segmented_download(server: SdoServer, dictionary: ObjectDictionary) -> None:
    data = struct.pack("<d", 3.5)
    assert server.handle(head(0x21, 0x2100, 4) + struct.pack("<I", 8)) == [head(0x60, 0x2100, 4) + bytes(4)]
    assert server.handle(b"\x00" + data[:7]) == [b"\x20" + bytes(7)]
    assert server.handle(b"\x1d" + data[7:] + bytes(6)) == [b"\x30" + bytes(7)]
    assert dictionary[0x2100, 4] == 3.5


def test_block_upload_with_a_lost_segment(server: SdoServer) -> None:
    (response,) = server.handle(head(0xA4, 0x2110, 3) + bytes([100, 0, 0, 0]))
    assert response == head(0xC6, 0x2110, 3) + struct.pack("<I", len(TRACE))
    got = b""
    frames = server.handle(b"\xa3" + bytes(7))
    lost = False
    while True:
        if not lost and len(got) >= 700:
            lost, frames = True, frames[:3]  # the client saw three only and asks for the rest again
        assert [frame[0] & 0x7F for frame in frames] == list(range(1, len(frames) + 1))
        got += b"".join(frame[1:] for frame in frames)
        answer = server.handle(bytes([0xA2, len(frames), 100]) + bytes(5))
        if frames[-1][0] & 0x80:
            break
        frames = answer
    unused = -len(TRACE) % 7
    assert got[: len(got) - unused] == TRACE
    assert answer == [struct.pack("<BH5x", 0xC1 | unused << 2, binascii.crc_hqx(TRACE, 0))]
    assert server.handle(b"\xa1" + bytes(7)) == []


def test_what_goes_wrong_is_aborted(server: SdoServer) -> None:
    assert server.handle(head(0x40, 0x7000, 1) + bytes(4)) == abort(0x7000, 1, AbortCode.NO_OBJECT)
    assert server.handle(head(0x2F, 0x6041, 0) + bytes(4)) == abort(0x6041, 0, AbortCode.READ_ONLY)
    server.handle(head(0x40, 0x2110, 3) + bytes(4))
    assert server.handle(b"\x70" + bytes(7)) == abort(0x2110, 3, AbortCode.TOGGLE)
    assert server.handle(b"\x60" + bytes(7)) == abort(0x2110, 3, AbortCode.COMMAND)  # the transfer is over
    assert server.handle(head(0xA0, 0x2110, 3) + bytes(4)) == abort(0x2110, 3, AbortCode.BLOCK_SIZE)
    assert server.handle(b"\xe0" + bytes(7)) == abort(0x2110, 3, AbortCode.COMMAND)
    assert server.handle(b"\x40") == []


INVALID = 1 << 31


@pytest.fixture
def pdos(dictionary: ObjectDictionary) -> tuple[list[PdoChannel], list[PdoChannel]]:
    return process_data(dictionary)


def write(dictionary: ObjectDictionary, index: int, subindex: int, value: int) -> None:
    dictionary.download(index, subindex, struct.pack("<B" if subindex == 0 else "<I", value))


def test_remapped_by_the_usual_procedure(
    dictionary: ObjectDictionary, pdos: tuple[list[PdoChannel], list[PdoChannel]]
) -> None:
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
    dictionary: ObjectDictionary,
    pdos: tuple[list[PdoChannel], list[PdoChannel]],
    writes: list[tuple[int, int, int]],
    code: AbortCode,
) -> None:
    *before, last = writes
    for step in before:
        write(dictionary, *step)
    with pytest.raises(SdoAbort) as refused:
        write(dictionary, *last)
    assert refused.value.code is code


EDS = Path(__file__).parents[4] / "config/eds"
INDICES = (0x1003, 0x1016, 0x1400, 0x1600, 0x1A00, 0x2100, 0x2101, 0x2110, 0x6040, 0x6060, 0x607A, 0x6081, 0x60FF)
LOOSE = settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def requests() -> st.SearchStrategy[bytes]:
    """SDO requests: any bytes, and what looks like one to an object that matters."""
    likely = st.builds(
        lambda command, index, sub, data: struct.pack("<BHB", command, index, sub) + data,
        st.integers(0, 255) | st.sampled_from([0x40, 0x21, 0x23, 0x2B, 0x2F, 0xA0, 0xA4]),
        st.sampled_from(INDICES),
        st.integers(0, 0x11),
        st.binary(min_size=4, max_size=4),
    )
    segments = st.builds(
        lambda head, data: bytes([head]) + data, st.integers(0, 255), st.binary(min_size=7, max_size=7)
    )
    return likely | segments | st.binary(max_size=9)


@pytest.fixture(params=["virtual-axis", "virtual-axis-rpm", "virtual-axis-no-limits"])
def any_server(request: pytest.FixtureRequest) -> tuple[SdoServer, VirtualAxis]:
    dictionary = ObjectDictionary(EDS / f"{request.param}.eds", 3)
    return SdoServer(dictionary), VirtualAxis(dictionary, 0.001, can_move=True)


@LOOSE
@given(stream=st.lists(requests(), max_size=30))
def test_the_sdo_server_answers_anything(any_server: tuple[SdoServer, VirtualAxis], stream: list[bytes]) -> None:
    sdo, axis = any_server
    for data in stream:
        touches_controlword = len(data) == 8 and data[0] >> 5 == 1 and data[1:4] == b"\x40\x60\x00"
        if touches_controlword:
            continue
        responses = sdo.handle(data)
        assert all(len(response) == 8 for response in responses)
        assert len(responses) <= 127
    assert not axis.energised
    assert not axis.setpoints(4).any()


@LOOSE
@given(
    frames=st.lists(
        st.tuples(
            st.sampled_from([0x000, 0x080, 0x202, 0x602, 0x77F, 0x182]) | st.integers(0, 0x7FF), st.binary(max_size=8)
        ),
        max_size=30,
    )
)
def test_an_axis_moves_only_when_a_controlword_enabled_it(
    cabinet: CanopenCabinet, frames: list[tuple[int, bytes]]
) -> None:
    now = 0.0
    for identifier, data in frames:
        now += 0.004
        cabinet.receive(Frame(identifier, data), now)
        cabinet.run(now)
    for number, node in enumerate(cabinet.nodes.values(), 1):
        enabling = any(
            identifier == 0x200 + number
            or (identifier == 0x600 + number and data[1:4] == b"\x40\x60\x00")
            or (identifier == 0x600 + number and len(data) == 8 and data[0] >> 5 == 0)
            for identifier, data in frames
        )
        assert enabling or not node.axis.energised


@pytest.fixture
def cabinet(scenario: Callable[[str], Scenario]) -> CanopenCabinet:
    sent: list[Frame] = []
    cabinet = CanopenCabinet(LiveMachine(scenario("rigid"), 1), EDS / "virtual-axis.eds", 1.0, sent.append)
    cabinet.boot()
    return cabinet
