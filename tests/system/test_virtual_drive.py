"""The virtual machine as a process, read by the `canopen` package on loopback; tests/unit/simulator shows the rest."""

import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import canopen
import numpy as np
import pytest
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError

ROOT = Path(__file__).resolve().parents[2]
EDS = str(ROOT / "config/eds/virtual-axis.eds")
COMMAND = [sys.executable, "-c", "from service.cli import main; main()", "drive"]
GEAR = 171.0  # of joint_1
PATIENCE = 60.0  # s for an answer
TRACE = np.dtype(
    [("cycle", "<u4"), ("torque", "<f4"), ("command", "<f4"), ("speed", "<f4"), ("enc", "<f8"), ("enc2", "<f8")]
)


@pytest.fixture
def ready() -> Iterator[dict[str, Any]]:
    """What the process says of its ports."""
    command = [*COMMAND, "--port", "0", "--control-port", "0", "--speed-factor", "20", "--seed", "1"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            yield json.loads(process.stdout.readline())
        finally:
            process.terminate()
            assert process.wait(60) == 0


@pytest.fixture
def network(ready: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> Iterator[canopen.Network]:
    monkeypatch.setattr(canopen.Network, "NOTIFIER_CYCLE", 0.02)
    monkeypatch.setattr(SdoClient, "RESPONSE_TIMEOUT", PATIENCE)
    bus = can.Bus(interface="socketcand", host="127.0.0.1", port=ready["port"], channel="can0", tcp_tune=True)
    network = canopen.Network(bus)
    network.connect()
    try:
        yield network
    finally:
        network.disconnect()


def entry(node: canopen.RemoteNode | canopen.LocalNode, index: int, sub: int | None = None) -> Any:
    """What an object's number leads to; canopen gives a variable, an array or a record by its dictionary."""
    found: Any = node.sdo[index]
    return found if sub is None else found[sub]


def test_says_who_it_is_and_keeps_its_ranges(ready: dict[str, Any], network: canopen.Network) -> None:
    nodes = [network.add_node(number, EDS) for number in range(1, 7)]
    identities = [[entry(node, 0x1018, sub).raw for sub in (1, 2, 3, 4)] for node in nodes]
    assert identities == [[0x5357, 0x402, 0x10000, 1000 + number] for number in range(1, 7)]
    assert entry(nodes[0], 0x1008).raw == "sweepid virtual axis"
    assert entry(nodes[0], 0x6076).raw == round(1000 * 3000 / GEAR)
    for index, value, code in ((0x605A, 7, 0x06090031), (0x605D, 0, 0x06090032), (0x6041, 0, 0x06010002)):
        with pytest.raises(SdoAbortedError) as refused:
            entry(nodes[0], index).raw = value
        assert refused.value.code == code
    with (
        socket.create_connection(("127.0.0.1", ready["control_port"]), timeout=PATIENCE) as control,
        control.makefile("rw") as lines,
    ):
        for order, told in (("status", True), ("explode", False)):
            lines.write(json.dumps({"order": order}) + "\n")
            lines.flush()
            reply = json.loads(lines.readline())
            assert reply["ok"] is told
            assert not any(axis["energised"] for axis in reply.get("axes", {}).values())


def test_measures_a_sweep_and_gives_its_trace(network: canopen.Network) -> None:
    node = network.add_node(1, EDS)
    entry(node, 0x6060).raw = 1
    for controlword, expected in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
        entry(node, 0x6040).raw = controlword
        assert entry(node, 0x6041).raw & 0x6F == expected
    for sub, value in {4: 0.1 * GEAR, 5: 0.25, 6: 0.5, 7: 1.0, 8: 2, 9: 2, 0x0A: 4}.items():
        entry(node, 0x2100, sub).raw = value
    for sub, frequency in enumerate((2.0, 5.0), 1):
        entry(node, 0x2101, sub).raw, entry(node, 0x2102, sub).raw = frequency, 5.0
    entry(node, 0x2100, 1).raw = 1
    deadline = time.monotonic() + PATIENCE
    while (state := entry(node, 0x2100, 2).raw) == 1:
        assert time.monotonic() < deadline
    assert state == 2
    assert entry(node, 0x2100, 0x0B).raw == 750  # 3 s at 4 ms
    data = b""
    for first in (0, 512):
        entry(node, 0x2110, 1).raw, entry(node, 0x2110, 2).raw = first, 512
        with entry(node, 0x2110, 3).open("rb", block_transfer=True, buffering=0) as page:
            block = page.read()
        assert block == node.sdo.upload(0x2110, 3)
        data += block
    trace = np.frombuffer(data, TRACE)
    assert np.array_equal(trace["cycle"], np.arange(750))
    window = slice(187, 687)  # about the two periods
    response = np.fft.rfft(trace["speed"][window])
    command = np.fft.rfft(trace["command"][window])
    assert abs(command[[4, 10]]) == pytest.approx([5 * 250] * 2, rel=0.02)
    assert abs(response[[4, 10]] / command[[4, 10]]) == pytest.approx([1.0, 1.0], abs=0.3)
    assert trace["enc"][-1] / GEAR == pytest.approx(trace["enc2"][-1], abs=1e-3)
    assert entry(node, 0x6041).raw & 0x6F == 0x27


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--scenario", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["--eds", "{bad}"], "{bad}: not an EDS"),
        (["--fieldbus", "modbus-tcp", "--registers", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["--fieldbus", "modbus-rtu", "--device", "/dev/no-such-line"], "no-such-line"),
    ],
)
def test_bad_arguments_end_with_one_line(arguments: list[str], reason: str, tmp_path: Path) -> None:
    bad = tmp_path / "bad.eds"
    bad.write_text("this is none")
    command = [*COMMAND, *(argument.format(bad=bad) for argument in arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert reason.format(bad=bad) in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
