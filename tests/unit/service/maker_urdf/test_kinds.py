"""Robots as manufacturers publish them: what is told of each kind that cannot be, or is a placeholder."""

import re
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from service import BadInput
from service.formats.maker_urdf import UrdfCheck, check_urdf, read_description, side_file_text
from service.formats.maker_urdf.packages import Packages

BODY = 'ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.02"'
LIMIT = '<limit lower="-2.5" upper="2.5" velocity="2" effort="200"/>'
OWN = f'<inertial><origin xyz="0 0 0.1"/><mass value="5"/><inertia {BODY}/></inertial>'
SHAPE = '<collision><origin xyz="0 0 0.1"/><geometry><box size="0.1 0.1 0.2"/></geometry></collision>'


def link(name: str, inertial: str = OWN, shape: str = SHAPE) -> str:
    return f'<link name="{name}">{inertial}{shape}</link>'


def joint(name: str, parent: str, child: str, inner: str = LIMIT, kind: str = "revolute") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.25"/><axis xyz="0 1 0"/>{inner}</joint>'
    )


def arm(l1: str = link("l1"), l2: str = link("l2"), j1: str = LIMIT, more: str = "") -> str:
    chain = f"{link('base')}{l1}{l2}{joint('j1', 'base', 'l1', j1)}{joint('j2', 'l1', 'l2')}"
    return f'<robot name="arm">{chain}{more}</robot>'


def inertial(mass: float = 5.0, tensor: str = BODY, centre: str = "0 0 0.1") -> str:
    return f'<inertial><origin xyz="{centre}"/><mass value="{mass}"/><inertia {tensor}/></inertial>'


def scaled(factor: float) -> str:
    return re.sub(r'"([\d.]+)"', lambda value: f'"{float(value[1]) * factor}"', BODY)


def box(x: float, y: float, z: float) -> str:
    return f'<collision><geometry><box size="{x} {y} {z}"/></geometry></collision>'


def checked(text: str, tip: str | None = "l2") -> UrdfCheck:
    return check_urdf(text, Packages([], Path()), tip, "arm.urdf")


def rows(text: str, tip: str | None = "l2") -> list[str]:
    told = [f"{one.kind} {one.place}: {one.sentence}" for one in checked(text, tip).findings]
    return [row for row in told if not re.search("gear ratio|rated effort|motor inertia|cogging orders", row)]


def limit(lower: str, upper: str, velocity: str = "2", effort: str = "200") -> str:
    return f'<limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="{effort}"/>'


def own(mass: float = 5.0, tensor: str = BODY, centre: str = "0 0 0.1") -> str:
    return arm(link("l1", inertial(mass, tensor, centre)))


NO_INERTIA = scaled(0)
BAR = link("bar", inertial(40.0, scaled(10)))
FOLLOWER = BAR + joint("p", "l1", "bar", f'{LIMIT}<mimic joint="j2"/>')
WIDENED = ("tensor zero", "mass negative", "mass placeholder", "placeholder without shape", "all equal", "no inertial")
TOLD = {
    "tensor zero": (own(tensor=NO_INERTIA), "unusual l1: has 5 kg and no inertia"),
    "mass negative": (own(-2.0), "unusual l1: has a mass of -2 kg"),
    "mass placeholder": (arm(l2=link("l2", inertial(1e-6, NO_INERTIA))), "unusual l2: has a mass of 1e-06 kg: a plac"),
    "placeholder without shape": (arm(l2=link("l2", inertial(1e-6), "")), "missing l2: its <inertial> is no body's"),
    "all equal": (arm(l2=link("l2", shape=box(0.3, 0.3, 0.9))), "unusual l1, l2: all have the same inertial of 5 kg"),
    "no inertial": (arm(link("l1", "")), "changed l1: has no <inertial>: 2 kg"),
    "triangle": (own(tensor=BODY.replace("0.02", "0.2")), "unusual l1: no body has its principal"),
    "negative inertia": (own(tensor=BODY.replace("0.02", "-0.02")), "no body has its principal"),
    "grams": (own(5000.0, scaled(1000)), "unusual l1: has 5e+03 kg in 2 dm^3"),
    "kg mm^2": (own(tensor=scaled(1e6)), "unusual l1: has a radius of gyration of 110 m in"),
    "g mm^2": (arm(link("l1", inertial(tensor=scaled(1e9)), "")), "unusual l1: has a radius of gyration of"),
    "centre in mm": (own(centre="0 0 100"), "unusual l1: has its centre of mass 99.9 m from"),
    "masses in grams": (
        arm(link("l1", inertial(5e4, scaled(1e4)), ""), link("l2", inertial(5e4, scaled(1e4)), "")),
        "unusual all links: moving mass 1e+05 kg with a reach of",
    ),
    "effort below gravity": (arm(j1=limit("-2", "2", effort="1")), "unusual j1: gravity needs up to"),
    "velocity infinite": (arm(j1=limit("-2", "2", "inf")), "missing j1: velocity limit: inf is not a usable limit"),
    "velocity nan": (arm(j1=limit("-2", "2", "nan")), "missing j1: velocity limit: nan is not a usable limit"),
    "velocity missing": (arm(j1='<limit lower="-2" upper="2"/>'), "missing j1: velocity limit: none is not a usable"),
    "effort missing": (arm(j1='<limit lower="-2" upper="2"/>'), "missing j1: effort limit: none is not a usable"),
    "effort 0": (arm(j1=limit("-2", "2", effort="0")), "missing j1: effort limit: 0 is not a usable limit"),
    "velocity in degrees": (arm(j1=limit("-2", "2", "150")), "unusual j1: velocity limit 150 rad/s is not plaus"),
    "position in degrees": (arm(j1=limit("-170", "170")), "unusual j1: position limits -170 to 170 rad, 27.1 turns"),
    "position 0": (arm(j1=limit("0", "0")), "missing j1: position limits 0 to 0 leave no travel"),
    "position infinite": (arm(j1=limit("-inf", "inf")), "missing j1: position limits -inf to inf leave no"),
    "position beyond all measure": (arm(j1=limit("-1e16", "1e16")), "missing j1: position limits -1e16 to 1e16"),
    "effort beyond all measure": (arm(j1=limit("-2", "2", effort="1e16")), "missing j1: effort limit: 1e16 is"),
    "position missing": (arm(j1='<limit velocity="2" effort="9"/>'), "missing j1: position limits none to none"),
    "limit missing": (arm(j1=""), "missing j1: position limits none to none leave no travel"),
    "soft limits": (
        arm(j1=f'{LIMIT}<safety_controller soft_lower_limit="-1.5" soft_upper_limit="1.5"/>'),
        "unusual j1: position limits -1.5 to 1.5 rad: the soft limits",
    ),
    "parallel bar": (
        arm(more=FOLLOWER),
        "unusual j2: part of a parallel linkage: p follows j2 (<mimic>) beside the chain. sweepid cannot "
        "measure these axes; 40 kg of moving mass",
    ),
    "counterbalance": (arm(more=link("balancer") + joint("s", "base", "balancer")), "unusual balancer: named like a"),
}


@pytest.mark.parametrize("kind", TOLD)
def test_what_cannot_be_is_told_and_widens_the_prior(kind: str) -> None:
    text, told = TOLD[kind]
    assert any(told in row for row in rows(text)), rows(text)
    assert ("inertia: 1.0" in side_file_text(checked(text), "arm", "arm.urdf")) == (kind in WIDENED)


def test_a_sound_arm_has_no_finding() -> None:
    assert rows(arm(l2=link("l2", inertial(4.0)))) == []


def test_limits_that_a_check_assumes_are_not_drafted() -> None:
    (error,) = checked(arm(j1="")).lacking
    assert str(error).startswith("arm.urdf joint j1: position limits")


@given(st.floats(0.5, 2), st.floats(0.5, 2), st.floats(0.2, 5))
def test_any_homogeneous_body_is_plausible(x: float, y: float, z: float) -> None:
    size = (0.1 * x, 0.1 * y, 0.2 * z)
    mass = 1000 * size[0] * size[1] * size[2]
    entries = {"ixx": (1, 2), "iyy": (0, 2), "izz": (0, 1)}
    tensor = " ".join(f'{key}="{mass * (size[a] ** 2 + size[b] ** 2) / 12}"' for key, (a, b) in entries.items())
    own = inertial(mass, f'{tensor} ixy="0" ixz="0" iyz="0"', "0 0 0")
    assert not [row for row in rows(arm(link("l1", own, box(*size)))) if "l1" in row]


# -- packages and xacro


def package(folder: Path, name: str = "arm_description") -> Path:
    """A cloned repository whose folder is not called like the package."""
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><!-- <name>other</name> --><name> {name} </name></package>")
    (folder / "part.xacro").write_text(
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="own" params="name mass">'
        + OWN.replace('"5"', '"${2 * mass}"').join(['<link name="${name}">', f"{SHAPE}</link></xacro:macro></robot>"])
    )
    text = arm("<xacro:own name='l1' mass='$(arg mass)'/>").replace(
        '<robot name="arm">',
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include '
        'filename="$(find arm_description)/part.xacro"/>',
    )
    (folder / "arm.urdf.xacro").write_text(text)
    return folder


@pytest.mark.parametrize("given", [".", "src", "src/Arm-main", "named", "by its folder"])
def test_a_package_is_found_by_its_name_wherever_its_folder_is(given: str, tmp_path: Path) -> None:
    folder = package(tmp_path / "src" / ("Arm-main" if given != "by its folder" else "a/arm_description"))
    if given == "by its folder":
        (folder / "package.xml").unlink()
        given = "src"
    named = {"arm_description": folder} if given == "named" else {}
    packages = Packages([] if named else [tmp_path / given], folder, named)
    assert packages.read("package://arm_description/part.xacro", "x")
    assert packages.folder("arm_description", "x") == folder.resolve()
    text = read_description(folder / "arm.urdf.xacro", packages, {"mass": "1.5"})
    assert checked(text).chain.inertial[0][0] == 3.0


def test_xacro_that_cannot_be_expanded_is_refused_by_name(tmp_path: Path) -> None:
    folder = package(tmp_path / "Arm-main")
    file, packages = folder / "arm.urdf.xacro", Packages([tmp_path], folder)
    good = file.read_text()
    for text, there, arguments, told in (
        (good, packages, {}, "argument mass has no value: give it by --xacro-arg mass:=VALUE"),
        (good, Packages([], folder), {"mass": "1"}, "package arm_description is not in .*: give it by --package arm_d"),
        (good.replace("$(arg mass)", "${half}"), packages, {"mass": "1"}, r"xacro: xacro: name 'half' is not defined"),
        ("<robot", packages, {}, r"arm\.urdf\.xacro: xacro: unclosed token"),
    ):
        file.write_text(text)
        with pytest.raises(BadInput, match=told):
            read_description(file, there, arguments)
