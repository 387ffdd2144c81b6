"""The bus against a raw peer on python-can's virtual bus, and behind a socketcand gateway; its load by hand."""

import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import can
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from drivers.canopen import bus as bus_module, frames
from drivers.canopen.bus import CanopenBus, SocketcandBus
from drivers.canopen.fieldbus import bus_load, check_bus_load
from drivers.canopen.profile import BusProfile, SetPointWay, load_device_map
from drivers.canopen.sdo import PdoMapping, streaming_pdos
from drivers.cia402.states import Controlword
from drivers.contract.bench import eventually
from drivers.errors import CommunicationLost, ConnectionFailed, LimitExceeded

NODE = 1
PATIENCE = 60.0  # s; a busy computer
DRIVE_TIMEOUT = 60.0  # s, which no test waits for: the bus' clock is set on instead


def line_of(**changes: object) -> BusProfile:
    return BusProfile.model_validate({"interface": "virtual", "channel": "can0", **changes})


def gateway_at(port: int) -> BusProfile:
    return line_of(interface="socketcand", host="127.0.0.1", port=port)


@dataclass(frozen=True)
class Pair:
    bus: CanopenBus
    peer: can.BusABC

    def say(self, identifier: int, data: bytes, error: bool = False) -> None:
        self.peer.send(
            can.Message(arbitration_id=identifier, data=data, is_extended_id=identifier > 0x7FF, is_error_frame=error)
        )


@pytest.fixture
def say_nothing(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """From its call on it is later by more than the time-out, in which no node has said a word."""
    later = SimpleNamespace(time=time.time, monotonic=lambda: time.monotonic() + 1.01 * DRIVE_TIMEOUT)
    return lambda: monkeypatch.setattr(bus_module, "time", later)


@pytest.fixture
def pair() -> Iterator[Pair]:
    channel = f"bus-{uuid.uuid4()}"
    peer = can.Bus(interface="virtual", channel=channel)
    bus = CanopenBus(line_of(channel=channel, drive_timeout=DRIVE_TIMEOUT), (NODE, 2))
    yield Pair(bus, peer)
    bus.close()
    bus.close()
    peer.shutdown()
    assert not [thread for thread in threading.enumerate() if thread.name == "can-receive"]


def soon(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_the_controllers_state_is_logged_once_a_change_and_told_when_the_bus_is_lost(
    pair: Pair, caplog: pytest.LogCaptureFixture
) -> None:
    stream = pair.bus.open_stream(NODE)
    warning, passive = (bytes([0, detail, 0, 0, 0, 0, 130, 0]) for detail in (0x08, 0x20))
    for data in (warning, warning, warning, passive, passive):
        pair.say(frames.ErrorClass.CONTROLLER, data, error=True)
    pair.say(frames.ErrorClass.RESTARTED, bytes(8), error=True)
    event = stream.get(timeout=PATIENCE)
    assert isinstance(event, frames.Lost)
    assert event.reason.endswith("restarted after bus-off (transmit errors 0, receive errors 0)")
    told = [record.message.partition("controller is ")[2] for record in caplog.records if "is error" in record.message]
    assert told == [
        "error warning (transmit errors 130, receive errors 0)",
        "error passive (transmit errors 130, receive errors 0)",
    ]


def test_a_stream_of_several_nodes_keeps_their_order_and_has_the_bus_own_events_once(pair: Pair) -> None:
    stream = pair.bus.open_stream(NODE, 2)
    pair.say(frames.Cob.HEARTBEAT + 2, b"\x05")
    pair.say(frames.Cob.RPDO1 + 2, bytes(6))
    pair.say(frames.Cob.SYNC, b"")
    pair.say(frames.Cob.HEARTBEAT + NODE, b"\x05")
    events = [stream.get(timeout=PATIENCE) for _ in range(4)]
    assert isinstance(events[2], frames.Sync)
    assert events[:2] + events[3:] == [frames.Heartbeat(2, 5), frames.SetPoint(2, bytes(6)), frames.Heartbeat(NODE, 5)]
    pair.bus.close_stream(NODE, 2)
    pair.say(frames.Cob.HEARTBEAT + 2, b"\x05")
    pair.say(frames.Cob.HEARTBEAT + NODE, b"\0")
    soon(lambda: pair.bus.restarted(NODE))
    assert stream.empty()


def test_a_node_that_falls_silent_is_lost_and_the_others_are_not(pair: Pair, say_nothing: Callable[[], None]) -> None:
    for node in (NODE, 2):
        pair.bus.check(node)
    say_nothing()
    stream, operational = pair.bus.open_stream(2), frames.NmtState.OPERATIONAL
    pair.say(frames.Cob.HEARTBEAT + 2, bytes([operational]))
    assert stream.get(timeout=PATIENCE) == frames.Heartbeat(2, operational)
    with pytest.raises(CommunicationLost, match="node 1: no heartbeat"):
        pair.bus.check(NODE)
    pair.bus.check(2)


def test_a_bus_on_which_nobody_speaks_is_lost_for_good(pair: Pair, say_nothing: Callable[[], None]) -> None:
    say_nothing()
    for _ in range(2):
        with pytest.raises(CommunicationLost, match="no node was heard"):
            pair.bus.check(NODE)
        pair.say(frames.Cob.HEARTBEAT + NODE, bytes([frames.NmtState.OPERATIONAL]))


def test_frames_with_29_bits_are_nobodys_word(pair: Pair) -> None:
    stream = pair.bus.open_stream(NODE)
    for identifier in (frames.Cob.EMERGENCY + NODE, frames.Cob.TPDO1 + NODE, frames.Cob.HEARTBEAT + NODE):
        pair.peer.send(can.Message(arbitration_id=identifier, data=bytes(8), is_extended_id=True))
    pair.say(frames.Cob.HEARTBEAT + NODE, b"\x05")
    assert stream.get(timeout=PATIENCE) == frames.Heartbeat(NODE, 5)
    assert pair.bus.emergency(NODE) is None


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 0x7FF) | st.sampled_from([0x581, 0x181, 0x081, 0x701]), st.binary(max_size=8))
def test_nothing_a_bus_may_carry_ends_the_receiving_thread(pair: Pair, identifier: int, data: bytes) -> None:
    stream = pair.bus.open_stream(2)
    pair.say(identifier, data)
    pair.say(frames.Cob.HEARTBEAT + 2, b"\x7f")
    event = stream.get(timeout=PATIENCE)
    while event != frames.Heartbeat(2, 0x7F):
        event = stream.get(timeout=PATIENCE)
    pair.bus.close_stream(2)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (
            {"interface": "socketcand", "host": "127.0.0.1", "port": 1},
            r"socketcand can0 at 127\.0\.0\.1:1 could not be opened",
        ),
        ({"interface": "telegraph"}, "telegraph"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_told_with_its_place(settings: dict[str, object], told: str) -> None:
    with pytest.raises(ConnectionFailed, match=told):
        CanopenBus(line_of(**settings), (NODE,))


def test_a_bus_on_which_nobody_is_heard_still_takes_the_stop() -> None:
    channel = f"halt-{uuid.uuid4()}"
    beats = {"host_heartbeat": 0.01, "drive_heartbeat": 0.01, "drive_timeout": 0.02}
    with can.Bus(interface="virtual", channel=channel) as peer:
        ours = CanopenBus(line_of(channel=channel, **beats), (1, 2))
        try:
            while not ours.silent(1):
                pass
            with pytest.raises(CommunicationLost):
                ours.check_alive()
            with pytest.raises(CommunicationLost):
                ours.send(frames.Cob.SYNC, b"")
            for identifier, data in frames.stop([1, 2], deaf=[2]):
                ours.shout(identifier, data)
        finally:
            ours.close()
        heard = []
        while (message := peer.recv(0.0)) is not None:
            heard.append((message.arbitration_id, bytes(message.data)))
    quick_stop = frames.rpdo1(Controlword.QUICK_STOP, 0)
    assert heard == [(0x201, quick_stop), (0x202, quick_stop), (frames.Cob.SYNC, b""), (frames.Cob.NMT, b"\x02\x02")]


@contextmanager
def gateway(answers: list[bytes]) -> Iterator[int]:
    """Its port. It says each answer in one packet, after a request of any kind, and stays until the host goes."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            server.accept()[0].close()  # the host asks first whether anybody is there
            connection, _ = server.accept()
            with connection:
                for answer in answers:
                    connection.sendall(answer)
                    if not connection.recv(256):
                        return
                while connection.recv(256):
                    pass

        thread = threading.Thread(target=serve)
        thread.start()
        yield server.getsockname()[1]
        thread.join(20)
        assert not thread.is_alive()


async def test_frames_in_the_packet_of_the_last_answer_are_frames() -> None:
    frames_ = b"< frame 701 12.5 7F >< frame 081 12.6 0010000000000000 >"
    with gateway([b"< hi >", b"< ok >", b"< ok >" + frames_]) as port:
        bus = CanopenBus(gateway_at(port), (1,))
        try:
            await eventually(lambda: bus.emergency(1) is not None)
            bus.send(frames.Cob.SYNC, b"")
        finally:
            bus.close()


@pytest.mark.parametrize("answers", [[b"< hi >", b"< no >"], [b"< hi >", b"< o"], [b"hello!"]])
def test_a_gateway_that_answers_otherwise_is_refused_and_nothing_stays_open(
    answers: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SocketcandBus, "answer_timeout", 0.5)
    with (
        gateway(answers) as port,
        pytest.raises(ConnectionFailed, match=r"could not be opened: (Expected|the gateway did not send) '< "),
    ):
        CanopenBus(gateway_at(port), (1,))


def cyclic_of(axes: int) -> list[tuple[PdoMapping, ...]]:
    plain = load_device_map(Path(__file__).parents[3] / "config/devices/plain-402.yaml")
    cyclic = tuple(p for p in streaming_pdos(plain, SetPointWay.CYCLIC_VELOCITY, 1) if len(p.mapped) > 1)
    assert len(cyclic) == 3
    return [cyclic] * axes


# a cycle of three axes: 55 + 3 (115 + 135 + 135) bits = 1210; heartbeats: 65 bits 40 times a second
@pytest.mark.parametrize(
    ("settings", "axes", "told"),
    [
        ({"bitrate": 250_000}, 3, r"bus can0: .*takes 122% of 250000 bit/s, 70% are allowed; sync_period 0\.008 s"),
        ({"bitrate": 250_000, "sync_period": 0.008}, 3, ""),
        ({"bitrate": 250_000, "sync_period": 0.007}, 3, "70% are allowed"),
        ({"bitrate": 1_000_000}, 3, ""),
        ({"sync_period": 0.001}, 20, ""),  # an unknown bit rate is not judged
        ({"bitrate": 10_000, "drive_heartbeat": 0.001}, 10, "no sync_period fits"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_figure_and_the_cycle_that_fits(
    settings: dict[str, float], axes: int, told: str
) -> None:
    with pytest.raises(LimitExceeded, match=told) if told else nullcontext():
        check_bus_load(line_of(**settings), cyclic_of(axes), axes)


def test_the_load_by_hand() -> None:
    # 1210 bits a cycle of 4 ms, and 65 bits 40 times a second (see above)
    settings = line_of(bitrate=1_000_000, sync_period=0.004)
    beats = 65 * (1 / settings.host_heartbeat + 3 / settings.drive_heartbeat)
    found = bus_load(settings, cyclic_of(3), 3)
    assert found == pytest.approx((1210 / 0.004 + beats) / 1e6)
    assert bus_load(line_of(), cyclic_of(3), 3) == 0.0
