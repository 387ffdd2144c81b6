"""One serial chain of a URDF that has fingers, wheels, followers and other trees."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from service import BadInput
from service.formats.maker_urdf.chain import choose_chain
from service.model import Chain, link_frames, read_chain
from service.model.urdf import read_origin

LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="4"/>'


def joint(name: str, kind: str, ends: str, inner: str = LIMIT) -> str:
    origin, axis = '<origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/>', '<axis xyz="0 1 1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{ends[0]}"/><child link="{ends[1]}"/>'
        f"{origin}{axis}{inner}</joint>"
    )


def robot(links: str, *joints: str) -> ET.Element:
    return ET.fromstring(
        f"<robot name='r'>{''.join(f'<link name={chr(34)}{x}{chr(34)}/>' for x in links)}{''.join(joints)}</robot>"
    )


def chain(root: ET.Element) -> Chain:
    return read_chain(ET.tostring(root, encoding="unicode"))


HAND = (joint("arm", "revolute", "ab"), joint("flange", "fixed", "bc"))
ONE, FOLLOWS = joint("one", "revolute", "ab"), f'{LIMIT}<mimic joint="one"/>'
FINGERS = (joint("left", "prismatic", "cd"), joint("right", "prismatic", "ce", f'{LIMIT}<mimic joint="left"/>'))


def test_a_serial_chain_stays_as_it_is() -> None:
    root = robot("abc", *HAND)
    before = ET.tostring(root)
    assert choose_chain(root, None, "x") == []
    assert ET.tostring(root) == before


def test_several_chains_are_told_with_their_tips() -> None:
    told = r"^gripper.urdf: has 2 chains; choose the end of one by --tip: c \(1 axes\), d \(2 axes\), e \(2 axes\)$"
    with pytest.raises(BadInput, match=told):
        choose_chain(robot("abcde", *HAND, *FINGERS), None, "gripper.urdf")


def test_what_is_not_on_the_way_is_fixed_and_told() -> None:
    root = robot("abcde", *HAND, *FINGERS)
    told = choose_chain(root, "c", "x")
    assert [(one.kind, one.place, one.sentence) for one in told] == [
        ("changed", "left", "is not between base and tip: fixed at 0"),
        ("changed", "right", "follows left (<mimic>): fixed at 0"),
    ]
    assert [one.name for one in chain(root).joints] == ["arm"]


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_joint_whose_limits_leave_out_0_is_fixed_at_the_nearest(kind: str) -> None:
    """A sensor hangs on a joint beside the way: where it is fixed, its mass is where the joint would have put it."""
    limit = '<limit lower="0.4" upper="2" velocity="3" effort="4"/>'
    ways = (joint("base", "revolute", "ab"), joint("side", kind, "bd", limit))
    moving = chain(robot("abd", *ways))
    root = robot("abd", *ways)
    choose_chain(root, "b", "x")
    side = root.findall("joint")[1]
    rotation, translation = read_origin(side, "x")
    turned, origins = link_frames(moving, np.array([0.0, 0.4]))
    np.testing.assert_allclose(turned[0].T @ turned[1], rotation, atol=1e-9)
    np.testing.assert_allclose(turned[0].T @ (origins[1] - origins[0]), translation, atol=1e-9)


def test_a_joint_without_end_gets_half_a_turn_either_way() -> None:
    root = robot("ab", joint("one", "continuous", "ab", '<limit velocity="3" effort="4"/>'))
    (told,) = choose_chain(root, None, "x")
    assert "limited to half a turn either way" in told.sentence
    (only,) = chain(root).joints
    assert (only.lower, only.upper) == (pytest.approx(-np.pi, abs=1e-6), pytest.approx(np.pi, abs=1e-6))


def test_another_tree_is_left_out_and_told() -> None:
    root = robot("abcd", ONE, joint("two", "revolute", "cd"))
    with pytest.raises(BadInput, match="has 2 chains"):
        choose_chain(root, None, "x")
    (told,) = choose_chain(root, "d", "x")
    assert (told.place, told.sentence) == ("a", "is the base of another tree: left out with all its links")
    assert [one.name for one in chain(root).joints] == ["two"]


@pytest.mark.parametrize(
    ("root", "tip", "told"),
    [
        (robot("ab", ONE), "z", "--tip: 'z' is not a link of x"),
        (robot("ab", joint("one", "fixed", "ab")), None, "has no moving joint"),
        (robot("abc", ONE, joint("two", "revolute", "cb")), None, "joints, one and two: a closed chain"),
        (robot("ab", ONE, joint("two", "revolute", "ba")), None, "is its own ancestor"),
        (robot("a", ONE), None, "link 'b' of joint 'one' is not defined"),
        (robot("ab", joint("one", "floating", "ab")), "b", "type 'floating' is not supported between base and tip"),
        (robot("abc", ONE, joint("two", "planar", "ac")), "b", "type 'planar' cannot be fixed"),
        (robot("abc", ONE, joint("two", "revolute", "ac", '<limit lower="x"/>')), "b", "limit"),
        (
            robot("abc", ONE, joint("two", "revolute", "bc", FOLLOWS)),
            None,
            "joint two: follows joint 'one' (<mimic>) and is between base and tip: a parallel linkage, whose axes "
            "sweepid cannot measure; choose a link before it by --tip",
        ),
    ],
)
def test_what_is_no_chain_is_told(root: ET.Element, tip: str | None, told: str) -> None:
    with pytest.raises(BadInput) as error:
        choose_chain(root, tip, "x")
    assert told in str(error.value)
