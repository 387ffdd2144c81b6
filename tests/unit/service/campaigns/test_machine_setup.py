"""Robot and cell of a machine by settings and files; what a start moves, and when it is not what was shown."""

import dataclasses
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from drivers.registry import load_profile
from service import BadInput, Conflict
from service.model import Robot, build_robot
from service.model.configuration import read_cell, read_robot
from service.planning.campaigns.stored_plan import MadeFor
from service.planning.compiled_plan import Range, check_seen, compile_plan, planned_sweeps, with_approach
from service.planning.documents import PlanRequest
from service.planning.machine_setup import (
    DriveAxis,
    DriveProfile,
    MachineSetup,
    NeedsConfirmation,
    differences,
    machine_setup,
    narrowed,
    on_machine,
)
from service.planning.plan import build_plan
from service.planning.safety.envelope_check import EnvelopeViolation
from service.process.settings import Settings
from service.store.database import open_database
from service.store.documents import CampaignDocument, CampaignState, RobotDocument
from service.store.store import Store
from tests.unit.service.campaigns.conftest import REACHED, ROOT, Bench

PROFILE = ROOT / "config" / "drives" / "virtual-max100.yaml"
JOINTS = tuple(f"joint_{k}" for k in range(1, 7))


@pytest.fixture
def robots(bench: Bench) -> dict[str, RobotDocument]:
    """Those of the repository: one of them has the joints of the drives."""
    return {path.stem: bench.store.add_robot(read_robot(path)) for path in (ROOT / "config" / "robots").glob("*.yaml")}


def setup_of(robots: dict[str, RobotDocument], **given: object) -> MachineSetup:
    return machine_setup(Settings.model_validate({"drive": PROFILE, **given}), load_profile(PROFILE), JOINTS, robots)


def test_what_does_not_fit_or_is_not_unique_has_to_be_set(
    robots: dict[str, RobotDocument], bench: Bench, tmp_path: Path
) -> None:
    setup = setup_of(robots, cells_dir=ROOT / "config" / "cells")
    assert (setup.robot, setup.cell, setup.missing) == (
        robots["max100-class"],
        "workshop",
        (),
    )  # the only one that fits
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
    unknown = dataclasses.replace(setup, cell=None, missing=("set it",))
    for machine, which, cell, of, told in (
        (setup, changed, "hall", made_for, "the plan is of cell hall"),
        (setup, changed, "workshop", made_for.model_copy(update={"machine": "cell 2"}), "make the plan again"),
        (unknown, robot, "workshop", None, "has none that is known"),
    ):
        with pytest.raises(Conflict, match=told):
            machine.check(which, cell, of)


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
    for seen, refusal in (
        (shown | {"joint_1": (0.0, 0.3)}, "to 0.4000 rad, outside of 0.0000 to 0.3000 rad"),
        ({"joint_2": (0.0, 0.0)}, "from 0.0000 to 0.4000 rad, which was not shown"),
    ):
        with pytest.raises(Conflict, match=f"joint_1 would move {refusal}"):
            check_seen(seen, compiled, pose, here)


CONFIG = Path(__file__).parents[4] / "config"
PROFILES = sorted((CONFIG / "drives").glob("*.yaml"))


def axes_of(path: Path) -> tuple[DriveAxis, ...]:
    return DriveProfile.model_validate(load_profile(path)).of(JOINTS)


def told(robot: Robot, axes: tuple[DriveAxis, ...], *moved: str) -> str:
    return differences(robot, "robot r", axes, "profile p", moved)


@pytest.mark.parametrize("path", PROFILES, ids=lambda path: path.stem)
def test_the_profiles_that_are_shipped_fit_their_robot(path: Path, robot: Robot) -> None:
    axes = axes_of(path)
    assert told(robot, axes, *JOINTS) == ""
    assert all(axis.gear_ratio and axis.rated_torque and axis.position_limits for axis in axes)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"gear_ratio": 60.0, "rated_torque": 350 / 60}, "joint_6 gear ratio: robot r has 101, profile p has 60"),
        ({"gear_ratio": -101.0}, "joint_6 gear ratio: robot r has 101, profile p has -101"),
        ({"rated_torque": 1.0}, "joint_6 rated effort: robot r has 350 N m, profile p has 101 N m"),
        ({"position_limits": (-6.3, 6.28)}, "joint_6 lower limit: robot r has -6.28 rad, profile p has -6.3 rad"),
        ({"position_limits": (-6.28, 7.0)}, "joint_6 upper limit: robot r has 6.28 rad, profile p has 7 rad"),
        ({"velocity_limit": 4.0}, "joint_6 velocity limit: robot r has 3.6 rad/s, profile p has 4 rad/s"),
        ({"effort_limit": 800.0}, "joint_6 effort limit: robot r has 700 N m, profile p has 800 N m"),
        ({"unit": "m"}, "joint_6 unit: robot r has rad, profile p has m"),
    ],
)
def test_a_difference_names_both_places_and_both_values(robot: Robot, change: dict[str, object], sentence: str) -> None:
    axes = axes_of(PROFILES[0])
    assert told(robot, (*axes[:-1], axes[-1].model_copy(update=change))) == sentence


@pytest.mark.parametrize(
    "change",
    [{"gear_ratio": 101.05}, {"rated_torque": 3.44}, {"velocity_limit": 0.2}, {"effort_limit": 90.0}, {"unit": None}]
    + [{"position_limits": (-3.0, 6.28)}, {"position_limits": (-6.28, 1.0)}]
    + [{name: None} for name in DriveAxis.model_fields if name != "joint"],
)
def test_rounded_values_lower_limits_and_what_a_profile_lacks_are_no_difference(
    robot: Robot, change: dict[str, object]
) -> None:
    axes = axes_of(PROFILES[0])
    assert told(robot, (*axes[:-1], axes[-1].model_copy(update=change))) == ""


def test_joints_go_by_name_and_order_and_those_that_do_not_move_need_no_drive(robot: Robot) -> None:
    axes = axes_of(PROFILES[0])
    other = tuple(axis.model_copy(update={"joint": f"axis_{k}"}) for k, axis in enumerate(axes))
    differ = tuple(axis.model_copy(update={"gear_ratio": 1.0, "effort_limit": 1e9}) for axis in axes)
    for drives, moved, words in (
        ((axes[1], axes[0], *axes[2:]), (), ("joints: robot r has joint_1, joint_2", "profile p has joint_2, joint_1")),
        (other, (), ("profile p has axis_0",)),
        (axes[:3], ("joint_4",), ("joints:",)),
        (differ, (), ("joint_1 gear ratio", "and 10 more")),  # a long list is cut
    ):
        assert all(word in told(robot, drives, *moved) for word in words)
    assert told(robot, axes[:3], "joint_1", "joint_3") == ""
    assert told(robot, axes[:3], "no_joint_of_it") == ""  # what the request says of it tells that


def test_a_profile_with_other_words_is_compared_by_its_joints() -> None:
    def axes(profile: dict[str, object], *joints: str) -> tuple[DriveAxis, ...]:
        return DriveProfile.model_validate(profile).of(joints)

    assert axes({"adapter": "other"}, "a", "b") == (DriveAxis(joint="a"), DriveAxis(joint="b"))
    assert axes({"axes": {"a": {"joint": "a"}}}, "a") == (DriveAxis(joint="a"),)
    assert axes({"axes": [{"joint": "a", "gear_ratio": "many"}, 3, {"joint": "b", "unit": "m"}]}, "a", "b") == (
        DriveAxis(joint="a"),
        DriveAxis(joint="b", unit="m"),
    )


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with open_database(f"sqlite:///{tmp_path / 'sweepid.sqlite'}") as database:
        yield Store(database)


SETTINGS = Settings(cells_dir=CONFIG / "cells", drive=PROFILES[0])


def planned(store: Store, stored: Robot, planned_for: Robot) -> CampaignDocument:
    """A campaign of one pose of a stored robot, planned with these limits."""
    robot_id = store.add_robot(stored).id
    request = PlanRequest(
        robot_id=robot_id, axes=("joint_2",), varied=("joint_3",), step=30.0, poses=1, cell="workshop"
    )
    document = build_plan(planned_for, request, read_cell(CONFIG / "cells/workshop.yaml"))
    plan = store.add_plan(robot_id, document.model_dump(mode="json"))
    return store.add_campaign(plan.id, planned_sweeps(plan))


def setup(store: Store, axes: tuple[DriveAxis, ...]) -> MachineSetup:
    """A machine of these drives, with the stored robot in the workshop."""
    return MachineSetup("machine", axes, robot=store.robots()[0], cell="workshop")


def test_a_campaign_for_another_machine_has_no_course(store: Store, robot: Robot) -> None:
    """Its robot's axis 6 has a gear of 60. `compile_plan` is asked at every start and resume."""
    axes = (*robot.axes[:-1], robot.axes[-1].model_copy(update={"gear_ratio": 60.0}))
    other = build_robot(robot.description.model_copy(update={"axes": axes}), robot.urdf_text)
    campaign = planned(store, other, other)
    with pytest.raises(Conflict) as refusal:
        compile_plan(store, SETTINGS, setup(store, axes_of(PROFILES[0])), campaign)
    said = str(refusal.value)
    assert said.startswith(f"campaign {campaign.id} is for another machine: joint_6 gear ratio: robot max100-class")
    assert f"has 60, drive profile {PROFILES[0]} has 101" in said
    assert "joint_1" in compile_plan(store, SETTINGS, setup(store, axes_of(PROFILES[0])[:3]), campaign).joints


def lowered(axes: tuple[DriveAxis, ...]) -> tuple[DriveAxis, ...]:
    """Axis 2 may give less than the robot's 7000 N m and 1.5 rad/s."""
    return (axes[0], axes[1].model_copy(update={"effort_limit": 6000.0, "velocity_limit": 0.05}), *axes[2:])


def test_limits_of_the_drives_below_the_robots_are_the_limits_and_are_told(robot: Robot) -> None:
    wide = DriveAxis(joint="joint_6", effort_limit=1e9, position_limits=(-3.0, 7.0))
    limited = on_machine(robot, (*lowered(axes_of(PROFILES[0]))[:-1], wide))
    assert np.array_equal(limited.chain.inertial, robot.chain.inertial)
    for index, own in ((1, {"effort": 6000.0, "velocity": 0.05}), (5, {"lower": -3.0})):  # never more than the robot's
        expected = vars(robot.chain.joints[index]) | own
        for name in ("lower", "upper", "velocity", "effort"):
            assert getattr(limited.chain.joints[index], name) == expected[name]
    one = DriveAxis(joint="joint_6", position_limits=(-3.0, 6.28), effort_limit=90.0)
    assert narrowed(robot, [one]) == (
        "joint_6 lower limit -3 instead of -6.28 rad; joint_6 effort limit 90 instead of 700 N m"
    )
    assert narrowed(robot, [DriveAxis(joint="joint_6", position_limits=(-6.28, 6.28))]) == ""


def test_a_profile_wider_than_the_soft_limits_of_the_robot_is_refused(robot: Robot) -> None:
    hard = 'upper="6.28"'
    assert hard in robot.urdf_text.rpartition('name="joint_6"')[2]
    head, name, tail = robot.urdf_text.rpartition('<joint name="joint_6"')
    begin, bracket, rest = tail.partition(">")
    soft = '<safety_controller soft_lower_limit="-1.5" soft_upper_limit="7" k_velocity="10"/>'
    gentle = build_robot(robot.description, head + name + begin + bracket + soft + rest)
    assert (gentle.chain.joints[5].lower, gentle.chain.joints[5].upper) == (-1.5, robot.chain.joints[5].upper)
    assert told(gentle, axes_of(PROFILES[0])) == "joint_6 lower limit: robot r has -1.5 rad, profile p has -6.28 rad"


@pytest.mark.parametrize("allowed", [True, False])
def test_a_plan_for_weaker_drives_keeps_their_limits(store: Store, robot: Robot, allowed: bool) -> None:
    """And one that was made for stronger drives is refused before anything moves."""
    axes = lowered(axes_of(PROFILES[0]))
    campaign = planned(store, robot, on_machine(robot, axes) if allowed else robot)
    compiled = compile_plan(store, SETTINGS, setup(store, axes), campaign)
    (sweep,), (command,) = store.sweeps(campaign.id), compiled.commands.values()
    with nullcontext() if allowed else pytest.raises(EnvelopeViolation, match=r"joint_2: .* limit"):
        compiled.envelope.check_sweep(command, sweep.spec.pose)
    assert (command.effort_limit <= 6000.0) is allowed
