"""`sweepid demo` with its real processes: to the end, and interrupted."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from service.report.benefit.benefit import Benefit
from service.store.files.bundle import read_bundle
from tests.system.test_stop import INTERRUPTIBLE

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="interrupts by POSIX signals")


SEED = 3  # hides Coulomb friction, which the first sweeps of a diagnosis cannot tell from an offset


def start(root: Path, out: Path, poses: int) -> "subprocess.Popen[str]":
    command = [sys.executable, "-c", INTERRUPTIBLE, "demo", "--out", str(out)]
    return subprocess.Popen(
        [*command, "--poses", str(poses), "--seed", str(SEED)],
        cwd=root,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"COLUMNS": "160"},
    )


def wait_for(condition: Callable[[], bool], seconds: float, process: "subprocess.Popen[str]") -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "timed out"
        time.sleep(0.1)


def events(log: Path) -> list[str]:
    if not log.exists():
        return []
    lines = [line for line in log.read_text().splitlines() if line.startswith("{")]
    return [json.loads(line).get("event", "") for line in lines]


def refuses(port: int) -> bool:
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) != 0


def test_demo_from_end_to_end(root: Path, tmp_path: Path) -> None:
    process = start(root, tmp_path, poses=8)
    try:
        words, errors = process.communicate(timeout=560)
    finally:
        process.kill()
    assert process.returncode == 0, errors

    assert len(read_bundle(tmp_path / "bundle").sweeps) == 24
    estimate = json.loads((tmp_path / "estimate.json").read_text())
    assert all(len(axis["inertia"]) == 8 for axis in estimate["axes"].values())
    # eight poses tell a few combinations worse than the nominal model does: those say why they have no std
    told = [parameter["std"] is not None for parameter in estimate["base_parameters"]]
    assert sum(told) >= 8
    assert all(known or one["reason"] for known, one in zip(told, estimate["base_parameters"], strict=True))
    report = (tmp_path / "report.html").read_text()
    assert report.count("<figure>") >= 8
    first = report.partition(">Drives</h3>")[0]
    assert re.search(r"Not confirmed\.|Contradicted\.", first)  # a verdict: nothing was diagnosed
    assert len(re.findall("; (no confidence stated|confidence [0-9.]+ %)", first)) == 3  # few poses may leave J open
    assert re.search(r"SHA-256 [0-9a-f]{64} .*\d{4}-\d\d-\d\d \d\d:\d\d UTC, sweepid \d", first, re.DOTALL)
    assert "Where model and measurement disagree: another machine" in report
    assert "Not the machine of the estimate above, but a second virtual one (max100-as-modelled)" in report

    (diagnosed,) = json.loads((tmp_path / "diagnosis.json").read_text())["axes"].values()
    assert [effect["effect"] for effect in diagnosed["effects"]] == ["coulomb_friction"]
    assert diagnosed["gap"]["after_rms"] < 1.1 * diagnosed["gap"]["noise_floor_rms"] < diagnosed["gap"]["before_rms"]
    assert diagnosed["summary"] in report
    assert "the diagnosis asks" in errors
    assert "Hidden: Coulomb friction (Coulomb 48.79 N m)" in words
    assert "Right; accepted as revision 1 of the model" in words

    def error(label: str) -> list[float]:
        """Median errors of the axes in a row of the table against the truth."""
        line = next(line for line in words.splitlines() if label in line)
        return [float(value) for value in re.findall(r"([\d.]+) \(", line)]

    worth = Benefit.read(json.loads((tmp_path / "benefit.json").read_text()), "benefit").axes
    assert [len(axis.held_out) for axis in worth.values()] == [2, 2, 2]
    assert all(axis.lines_ratio > 1 and axis.smallest_ratio > 1 for axis in worth.values())
    assert ">What you gain</h2>" in report
    assert ">The same path with either model</h3>" in report
    assert "a torque feed-forward leaves" in words

    ours, paper = error("sweepid model, whole workspace"), error("formula of the paper, whole workspace")
    assert len(ours) == len(paper) == 3
    assert max(ours) < 2.0
    assert all(own < theirs for own, theirs in zip(ours, paper, strict=True))
    for profile in (tmp_path / "drives.yaml", tmp_path / "hidden" / "drives.yaml"):
        assert refuses(yaml.safe_load(profile.read_text())["bus"]["port"])


def test_interrupted_demo_stops_the_machine_first(root: Path, tmp_path: Path) -> None:
    process = start(root, tmp_path, poses=8)
    log = tmp_path / "serve.log"
    try:
        wait_for(lambda: "recorded" in events(log), 300, process)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 1
    assert "the machine was stopped" in errors
    told = events(log)
    assert told.index("stop") < told.index("Shutting down")
    assert refuses(yaml.safe_load((tmp_path / "drives.yaml").read_text())["bus"]["port"])


def test_outside_the_checkout_it_says_what_is_missing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", "from service.cli import main; main()", "demo", "--out", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 2
    assert "config/scenarios/max100-full.yaml: not found" in done.stderr.replace("\\", "/")
    assert not (tmp_path / "out").exists()
