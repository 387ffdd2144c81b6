"""Reading a URDF: what the specification's defaults mean, folding of fixed joints, and refusals by name."""

import numpy as np
import pytest

from service import BadInput
from service.model import read_chain
from service.model.urdf import DEEPEST, MOST_ELEMENTS, MOST_LINKS

BODY = '<inertial><mass value="2"/><inertia ixx="1" iyy="2" izz="3" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="4"/>'


def joint(name: str, kind: str, parent: str, child: str, inner: str = LIMIT) -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inner}</joint>'


def robot(*parts: str, links: str = "ab") -> str:
    return (
        f"<robot name='r'>{''.join(f'<link name={chr(34)}{name}{chr(34)}/>' for name in links)}{''.join(parts)}</robot>"
    )


def _soft(safety: str) -> str:
    limit = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'
    return robot(joint("j", "revolute", "a", "b", f"{limit}<safety_controller {safety}/>"))


def _long_chain(count: int) -> str:
    links = "".join(f'<link name="l{number}"/>' for number in range(count))
    joints = "".join(joint(f"j{number}", "fixed", f"l{number}", f"l{number + 1}") for number in range(count - 1))
    return f"<robot>{links}{joints}</robot>"


ENTITY = '<!DOCTYPE robot [<!ENTITY e SYSTEM "file:///etc/hostname">]><robot>&e;</robot>'


def test_defaults_of_the_specification() -> None:
    (only,) = read_chain(robot(joint("j", "revolute", "a", "b"))).joints
    np.testing.assert_array_equal(only.axis, [1, 0, 0])
    np.testing.assert_array_equal(only.rotation, np.eye(3))
    assert (only.lower, only.upper, only.velocity, only.effort, only.link) == (-1, 2, 3, 4, "b")


def test_a_continuous_joint_has_no_ends() -> None:
    (only,) = read_chain(robot(joint("j", "continuous", "a", "b", '<axis xyz="0 0 2"/>'))).joints
    assert (only.kind, only.lower, only.upper) == ("revolute", -np.inf, np.inf)
    np.testing.assert_array_equal(only.axis, [0, 0, 1])


def test_what_is_fixed_to_the_base_is_no_load() -> None:
    text = robot(f'<link name="c">{BODY}</link>', joint("f", "fixed", "a", "c", ""), joint("j", "prismatic", "c", "b"))
    chain = read_chain(text)
    assert chain.joints[0].kind == "prismatic"
    np.testing.assert_array_equal(chain.inertial, np.zeros((1, 10)))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<robot", "not XML"),
        ("<robot><a:link/></robot>", "not XML: unbound prefix"),
        ("<robot/>", "needs one base link, has 0"),
        (robot(), "needs one base link, has 2"),
        (robot(links="a"), "has no moving joint"),
        (robot(joint("j", "revolute", "a", "c")), "needs one base link"),
        (robot(joint("j", "revolute", "a", "c"), links="a"), "link 'c' of a joint is not defined"),
        (robot(joint("j", "floating", "a", "b")), "j: type 'floating' is not supported"),
        (robot(joint("j", "revolute", "a", "b", "")), "j: has no <limit>"),
        (robot(joint("j", "revolute", "a", "b", LIMIT.replace('"2"', '"-1"'))), "lower limit -1.0 is not below"),
        (robot(joint("j", "revolute", "a", "b", LIMIT.replace('"4"', '"no"'))), "limit effort='no' is not a number"),
        (robot(joint("j", "revolute", "a", "b", LIMIT + '<axis xyz="0 0 0"/>')), "axis has no direction"),
        (robot(joint("j", "revolute", "a", "b", LIMIT + '<origin xyz="0 0"/>')), "is not three finite numbers"),
        (robot(joint("j", "revolute", "a", "b", LIMIT + '<origin xyz="0 0 x"/>')), "is not three numbers"),
        (robot('<joint name="j" type="fixed"><parent link="a"/></joint>'), "j: has no <child link=...>"),
        (
            robot(joint("j", "revolute", "a", "b"), joint("k", "revolute", "a", "c"), links="abc"),
            "two or more moving joints",
        ),
        (robot(joint("j", "revolute", "a", "b", f'{LIMIT}<mimic joint="k"/>')), "j: follows joint 'k' (<mimic>)"),
        (robot(joint("j", "fixed", "a", "b"), joint("k", "fixed", "b", "b")), "the child of two joints"),
        (robot(joint("j", "fixed", "a", "b"), joint("k", "fixed", "a", "b")), "the child of two joints"),
        (robot('<link name="a"/>', joint("j", "revolute", "a", "b")), "link 'a' occurs twice"),
        (robot(joint("j", "fixed", "a", "b"), joint("j", "revolute", "b", "c"), links="abc"), "joint 'j' occurs twice"),
        (
            robot(joint("j", "revolute", "a", "c"), '<link name="c"><inertial/></link>', links="a"),
            "<inertial> needs <mass> and <inertia>",
        ),
        (_long_chain(MOST_LINKS + 1), f"has {MOST_LINKS + 1} links, limit {MOST_LINKS}"),
        ("<robot>" + "<a>" * 500_000 + "</a>" * 500_000 + "</robot>", f"is nested deeper than {DEEPEST}"),
        ("<robot>" + "<a/>" * 500_000 + "</robot>", f"more than {MOST_ELEMENTS} elements"),
        (ENTITY, "declares a DOCTYPE"),
        ("<robot><link name='" + "a" * 201 + "'/></robot>", "name 'aaaaaaaaaaaaaaaaaaaa' of a link is longer than 200"),
        ('<robot><link name="a&#10;b"/></robot>', "not printable"),
        (robot(joint("j", "revolute", "a", "b", LIMIT.replace('"4"', '"1e308"'))), "beyond 1e+15"),
        (robot(joint("j", "revolute", "a", "b", LIMIT + '<origin xyz="0 0 1e308"/>')), "three finite numbers"),
        (_soft('soft_lower_limit="0.5" soft_upper_limit="-0.5" k_velocity="1"'), "lower limit 0.5 is not below upper"),
    ],
)
def test_refusals_name_the_reason(text: str, reason: str) -> None:
    with pytest.raises(BadInput) as refusal:
        read_chain(text, "robot.urdf")
    assert str(refusal.value).startswith("robot.urdf")
    assert reason in str(refusal.value)


@pytest.mark.parametrize(
    ("safety", "limits"),
    [
        ('soft_lower_limit="-0.5" soft_upper_limit="0.75" k_position="20" k_velocity="10"', (-0.5, 0.75, True)),
        ('soft_upper_limit="0.75" k_velocity="10"', (-1.0, 0.75, True)),  # no lower one, and none of 0
        ('soft_lower_limit="-2" soft_upper_limit="2" k_velocity="10"', (-1.0, 1.0, False)),
        ('k_velocity="10"', (-1.0, 1.0, False)),
    ],
)
def test_the_narrower_of_hard_and_soft_limits_counts(safety: str, limits: tuple[float, float, bool]) -> None:
    joint = read_chain(_soft(safety)).joints[0]
    assert (joint.lower, joint.upper, joint.soft) == limits
