"""Robot and cell of a machine by settings and files; what a start moves, and when it is not what was shown."""

import dataclasses
from pathlib import Path

import pytest

from drivers.registry import load_profile
from service.model.configuration import read_robot
from service.model.errors import BadInput, Conflict
from service.planning.campaigns.stored_plan import MadeFor
from service.planning.compiled_plan import Range, check_seen, with_approach
from service.planning.machine_setup import MachineSetup, NeedsConfirmation, machine_setup
from service.process.settings import Settings
from service.store.documents import CampaignState, RobotDocument
from service.store.store import Store
from tests.unit.service.campaigns.conftest import REACHED, ROOT, Bench

PROFILE = ROOT / "config" / "drives" / "virtual-max100.yaml"
JOINTS = tuple(f"joint_{number}" for number in range(1, 7))


@pytest.fixture
def robots(bench: Bench) -> dict[str, RobotDocument]:
    """Those of the repository: one of them has the joints of the drives."""
    return {path.stem: bench.store.add_robot(read_robot(path)) for path in (ROOT / "config" / "robots").glob("*.yaml")}


def setup_of(robots: dict[str, RobotDocument], **given: object) -> MachineSetup:
    return machine_setup(Settings.model_validate({"drive": PROFILE, **given}), load_profile(PROFILE), JOINTS, robots)


def test_the_only_one_that_fits_is_the_machines(robots: dict[str, RobotDocument]) -> None:
    setup = setup_of(robots, cells_dir=ROOT / "config" / "cells")
    assert (setup.robot, setup.cell, setup.missing) == (robots["max100-class"], "workshop", ())


def test_what_does_not_fit_or_is_not_unique_has_to_be_set(
    robots: dict[str, RobotDocument], bench: Bench, tmp_path: Path
) -> None:
    newer = copy_of(bench.store, robots["max100-class"], "max100-newer")
    cells = tmp_path / "cells"
    cells.mkdir()
    (cells / "rail.yaml").write_text("name: rail\nhome: {slide: 0.1}\n", "utf-8")  # of another robot
    setup = setup_of({**robots, "max100-newer": newer}, cells_dir=cells)
    assert (setup.robot, setup.cell) == (None, "rail")  # whose cell it is cannot be known without the robot
    (told,) = setup.missing
    assert "set `robot` (SWEEPID_ROBOT)" in told
    assert "max100-class, max100-newer fit the machine" in told
    named = setup_of({**robots, "max100-newer": newer}, cells_dir=cells, robot="max100-newer")
    assert (named.robot, named.cell) == (newer, None)
    assert "none fits the machine" in named.missing[0]
    with pytest.raises(Conflict, match="machine 'machine' has no cell: set `cell`"):
        named.own_cell()
    (cells / "broken.yaml").write_text("name: [", "utf-8")  # it may be the cell
    (cells / "hall.yaml").write_text("name: hall\n", "utf-8")
    assert "broken, hall fit the machine" in setup_of(robots, cells_dir=cells).missing[0]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"robot": "nobody"}, "robot: there is no robot nobody in .*; there is: emps, max100-class"),
        ({"cell": "x"}, "cell"),
    ],
)
def test_a_setting_that_names_no_file_is_refused(
    robots: dict[str, RobotDocument], given: dict[str, str], told: str
) -> None:
    with pytest.raises(BadInput, match=told):
        setup_of(robots, cells_dir=ROOT / "config" / "cells", **given)


def test_a_changed_description_is_another_robot_and_another_file_name_is_not(
    robots: dict[str, RobotDocument], bench: Bench
) -> None:
    setup, robot = setup_of(robots, cells_dir=ROOT / "config" / "cells"), robots["max100-class"]
    moved = robot.model_copy(update={"id": 99, "description": robot.description.model_copy(update={"urdf": "x.urdf"})})
    assert setup.confirmed(moved, "workshop", {}, "") == MadeFor(machine="machine")
    changed = robot.model_copy(update={"id": 99, "urdf_text": f"{robot.urdf_text}\n"})
    with pytest.raises(NeedsConfirmation, match=r"max100-class \(number 99\), but machine 'machine' has max100-class"):
        setup.confirmed(changed, "workshop", {"cell": "workshop"}, "")
    made_for = setup.confirmed(changed, "workshop", {"robot": " max100-class "}, "Ada")
    assert (made_for.confirmed, made_for.by) == ({"robot": "max100-class"}, "Ada")
    setup.check(changed, "workshop", made_for)
    with pytest.raises(Conflict, match="the plan is of cell hall"):
        setup.check(changed, "hall", made_for)
    with pytest.raises(Conflict, match="make the plan again"):
        setup.check(changed, "workshop", made_for.model_copy(update={"machine": "cell 2"}))
    with pytest.raises(Conflict, match="has none that is known"):
        dataclasses.replace(setup, cell=None, missing=("set it",)).check(robot, "workshop", None)


def copy_of(store: Store, robot: RobotDocument, name: str) -> RobotDocument:
    built = robot.build()
    return store.add_robot(dataclasses.replace(built, description=built.description.model_copy(update={"name": name})))


async def test_a_resume_is_refused_if_an_axis_has_left_what_was_shown(bench: Bench) -> None:
    bench.drive.hold = 1
    await bench.start()
    await bench.drive.holding.wait()
    stop = await bench.machine.stop("berta", "enough")
    await bench.over()
    await bench.machine.reset_stop("berta", [stop.id])
    seen: dict[str, Range] = dict.fromkeys(REACHED, (-0.5, 0.5))
    bench.drive.position["joint_2"] = 0.6
    before = list(bench.drive.trace)
    with pytest.raises(Conflict, match=r"joint_2 stands at 0.6000 rad, outside of -0.5000 to 0.5000 rad"):
        await bench.resume(repeat=True, seen=seen)
    assert bench.drive.trace == before
    assert bench.now.state is CampaignState.PAUSED
    bench.drive.position["joint_2"], bench.drive.hold = 0.501, None  # within the tolerance of a pose
    await bench.resume(repeat=True, seen=seen)
    assert (await bench.over()).state is CampaignState.MEASURED


def test_the_approach_itself_stays_in_what_was_shown(bench: Bench) -> None:
    compiled = bench.compile_plan(bench.campaign)
    here: dict[str, float] = dict.fromkeys(REACHED, 0.0)
    pose = (0.4, 0.0, 0.0, 0.0, 0.0, 0.0)
    shown = with_approach({}, compiled.joints, here, [(0, 0.4)])
    assert shown == {"joint_1": (0.0, 0.4), "joint_2": (0.0, 0.0), "joint_3": (0.0, 0.0)}
    check_seen(shown, compiled, pose, here)
    with pytest.raises(Conflict, match=r"joint_1 would move to 0.4000 rad, outside of 0.0000 to 0.3000 rad"):
        check_seen(shown | {"joint_1": (0.0, 0.3)}, compiled, pose, here)
    with pytest.raises(Conflict, match=r"joint_1 would move from 0.0000 to 0.4000 rad, which was not shown"):
        check_seen({"joint_2": (0.0, 0.0)}, compiled, pose, here)
