"""Any frames at all: no crash, and no axis moves but one that was enabled by the state table."""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from simulator import Scenario
from simulator.canopen.cabinet import Cabinet
from simulator.canopen.node import Frame
from simulator.canopen.sdo import SdoServer
from simulator.drive.axis import Axis
from simulator.drive.dictionary import Dictionary
from simulator.machine import Machine

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
def server(request: pytest.FixtureRequest) -> tuple[SdoServer, Axis]:
    dictionary = Dictionary(EDS / f"{request.param}.eds", 3)
    return SdoServer(dictionary), Axis(dictionary, 0.001, can_move=True)


@LOOSE
@given(stream=st.lists(requests(), max_size=30))
def test_the_sdo_server_answers_anything(server: tuple[SdoServer, Axis], stream: list[bytes]) -> None:
    sdo, axis = server
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
def test_an_axis_moves_only_when_a_controlword_enabled_it(cabinet: Cabinet, frames: list[tuple[int, bytes]]) -> None:
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
def cabinet(scenario: Callable[[str], Scenario]) -> Cabinet:
    sent: list[Frame] = []
    cabinet = Cabinet(Machine(scenario("rigid"), 1), EDS / "virtual-axis.eds", 1.0, sent.append)
    cabinet.boot()
    return cabinet
