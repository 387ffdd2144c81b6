"""Whoever follows the guide to a CANopen drive connects: its profile, on nodes made of that drive's dictionary."""

import shutil
from pathlib import Path
from typing import Any, cast

import pytest
import yaml
from typer.testing import CliRunner

from drivers.commission.command import commission
from drivers.contract.bench import closing
from drivers.errors import WrongIdentity
from drivers.ports import AxisState, DrivePort
from drivers.registry import load_profile, open_drive
from tests.contract.makers import PATIENCE
from tests.foreign_bench import ROOT, Foreign, bench
from tests.guide import written

ROOM = {"travel_limits": {"rad": 1e3}}  # for as long as the bench waits for its host
GUIDE = ROOT / "docs" / "how-to" / "connect-a-canopen-drive.md"


@pytest.fixture
def drives(tmp_path: Path) -> Path:
    """The folder that the guide tells one to fill, beside the maps of the house."""
    shutil.copytree(ROOT / "config" / "devices", tmp_path / "devices")
    return tmp_path / "drives"


@pytest.fixture
def rated_torque() -> float:
    """Of the virtual machine, whose motor is larger than the guide's."""
    (machine, *_) = cast(Any, load_profile(ROOT / "config" / "drives" / "virtual-max100.yaml")["axes"])
    return machine["rated_torque"]


async def test_the_profile_of_the_guide_leads_to_its_drive(drives: Path, rated_torque: float) -> None:
    written(GUIDE.name, drives)
    with bench("epos4") as foreign:
        shutil.copy(foreign.files["joint_1"], drives / "epos4.dcf")
        profile = load_profile(drives / "my-machine.yaml")
        (axis,) = cast(Any, profile["axes"])
        with pytest.raises(WrongIdentity, match="rated torque of the motor"):  # the virtual machine's is larger
            await connected(profile, foreign, drives)
        port = await connected(profile | {"axes": [axis | {"rated_torque": rated_torque}]}, foreign, drives)
        async with closing(port):
            assert f"`{port.capabilities.set_points}`" in GUIDE.read_text()
            assert (await port.status())["joint_1"].state is AxisState.DISABLED
            assert not foreign.truth()["energised"]


def test_the_check_of_the_guide_asks_its_drive(drives: Path, rated_torque: float) -> None:
    commands = [line for line in written(GUIDE.name, drives) if line.startswith("sweepid commission check")]
    assert [line.split()[4:] for line in commands] == [[], ["--turn", "joint_1=30"]]
    with bench("epos4") as foreign:
        shutil.copy(foreign.files["joint_1"], drives / "epos4.dcf")
        path = drives / commands[0].split()[3]
        content = load_profile(path)
        (axis,) = cast(Any, content["axes"])
        path.write_text(yaml.safe_dump(content | ROOM | {"bus": {**foreign.bus, **PATIENCE}}))
        wrong = CliRunner().invoke(commission, ["check", str(path)])
        assert wrong.exit_code == 1
        assert "joint_1: rated-torque: 6076h: the motor has 17.54 N m, the profile 0.5129 N m" in wrong.output
        right = {"axes": [axis | {"rated_torque": rated_torque}]}
        path.write_text(yaml.safe_dump(load_profile(path) | right))
        done = CliRunner().invoke(commission, ["check", str(path)])
        assert done.exit_code == 0, done.output
        told = {line.split()[1] for line in done.output.splitlines() if line.startswith("joint_1 ")}
        assert {"rated-torque", "position", "standstill", "excitation", "pdos", "position-limits"} <= told
        assert not foreign.truth()["energised"]


async def connected(profile: dict[str, Any], foreign: Foreign, base: Path) -> DrivePort:
    """On the bus of the nodes instead of can0."""
    cycle = profile["bus"]["sync_period"]
    port = open_drive(profile | ROOM | {"bus": {**foreign.bus, **PATIENCE, "sync_period": cycle}}, base)
    try:
        await port.connect()
    except BaseException:
        await port.close()
        raise
    return port
