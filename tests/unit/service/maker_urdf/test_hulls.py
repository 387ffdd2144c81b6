"""Convex hulls hold all of their mesh, stay near it, and a guessed inertial is that of the body they enclose."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial import ConvexHull

from service import BadInput
from service.formats.maker_urdf.inertials import (
    FINEST,
    MOST_VERTICES,
    PLAUSIBLE,
    check_inertials,
    convex_hull,
    embed_hulls,
    solid,
)
from service.formats.maker_urdf.packages import Packages
from service.model import read_chain
from service.model.urdf import read_hull

ARM = """<robot name="arm"><link name="base"/><joint name="j" type="revolute"><parent link="base"/><child link="tip"/>
<axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint><link name="tip">{shape}</link></robot>"""
BOX = np.array([[x, y, z] for x in (0.1, 0.3) for y in (-0.2, 0.2) for z in (0.0, 0.1)])


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 3000), size=st.sampled_from([1e-3, 0.1, 3.0]))
def test_no_point_is_left_out_and_none_is_far(seed: int, count: int, size: float) -> None:
    points = size * np.random.default_rng(seed).normal(size=(count, 3))
    vertices, off = convex_hull(points)
    assert len(vertices) <= MOST_VERTICES
    planes = ConvexHull(vertices).equations
    assert (points @ planes[:, :3].T + planes[:, 3]).max() < 1e-9 * max(size, 1)
    nearest = np.sqrt(((vertices[:, None, :] - points[None]) ** 2).sum(-1)).min(1)
    assert nearest.max() <= off * (1 + 1e-9)


def test_a_flat_mesh_gets_a_thickness_and_a_box_has_the_volume_and_moments_of_a_box() -> None:
    vertices, off = convex_hull(BOX * [1, 1, 0])
    assert np.ptp(vertices[:, 2]) == pytest.approx(FINEST)
    assert off < 2 * FINEST
    volume, centre, moment = solid(BOX)
    edges = np.array([0.2, 0.4, 0.1])
    assert volume == pytest.approx(0.2 * 0.4 * 0.1)
    np.testing.assert_allclose(centre, [0.2, 0.0, 0.05], atol=1e-12)
    np.testing.assert_allclose(moment - volume * np.outer(centre, centre), volume * np.diag(edges**2) / 12, atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        *(
            (f"{origin}<geometry>{shape}</geometry>", f"{reason} m: limits 1e-06 and 10000 m")
            for origin in ("", '<origin xyz="1 0 0"/>')
            for shape, reason in (
                ('<box size="nan 1 1"/>', r"collision <box>: size='nan 1 1'"),
                ('<box size="1 0 1"/>', "size='1 0 1'"),
                ('<sphere radius="1e308"/>', "radius='1e308'"),
                ('<sphere radius=""/>', "radius=''"),
                ('<cylinder radius="0.1" length="0"/>', "length='0'"),
                ('<capsule radius="5e-324" length="1"/>', "radius='5e-324'"),
            )
        ),
        (
            '<origin xyz="1e5 0 0"/><geometry><sphere radius="1"/></geometry>',
            r"collision <sphere> reaches 1e\+05 m, limit 10000 m",
        ),
    ],
)
def test_a_shape_that_encloses_nothing_gives_no_inertial(shape: str, reason: str) -> None:
    root = ET.fromstring(ARM.format(shape=f"<collision>{shape}</collision>"))
    (found,) = check_inertials(root, "arm.urdf")[0]
    assert (found.kind, found.place) == ("missing", "tip")
    assert re.search(f"has no <inertial>, and its shapes give none: .*{reason}", found.sentence)
    assert root.find("link[@name='tip']/inertial") is None


def test_a_link_with_neither_inertial_nor_shape_is_missing() -> None:
    (told,) = check_inertials(ET.fromstring(ARM.format(shape="")), "x")[0]
    assert (told.kind, told.place) == ("missing", "tip")


def test_a_mesh_of_many_links_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n")
    shape = '<collision><geometry><mesh filename="a.obj"{}/></geometry></collision>'
    root = ET.fromstring(ARM.format(shape=shape.format("") * 50 + shape.format(' scale="2 2 2"')))
    reads: list[str] = []
    packages = Packages([tmp_path], tmp_path)
    read = packages.read
    monkeypatch.setattr(packages, "read", lambda name, here: reads.append(name) or read(name, here))
    _, unread = embed_hulls(root, packages, "arm.urdf")
    assert (unread, reads) == ([], ["a.obj"] * 2)
    hulls = [np.ptp(read_hull(mesh, "x"), axis=0) for mesh in root.iter("mesh")]
    np.testing.assert_allclose(hulls, [[1, 1, 1]] * 50 + [[2, 2, 2]], atol=3e-4)


@pytest.mark.parametrize(
    ("hull", "told"),
    [
        ("", "`sweepid robot check URDF --packages DIR` puts it in"),
        ('<hull vertices="1 2 3 4"/>', "not finite numbers in threes"),
        ('<hull vertices="1 2 nan"/>', "not finite numbers in threes"),
        ('<hull vertices="1 2 x"/>', "could not convert"),
        ('<hull vertices="0 0 0 1 0 0 0 1 0 0 0 2e4"/>', "reaches 2e+04 m, limit 10000 m"),
        ('<hull vertices="0 0 0 1 0 0 0 1 0 1 1 0"/>', "all in one plane"),
        (f'<hull vertices="{"0 " * 30001}"/>', "more than 30000 numbers"),
    ],
)
def test_a_hull_that_is_none_is_told(hull: str, told: str) -> None:
    with pytest.raises(BadInput, match=f"mesh a.stl: .*{re.escape(told)}"):
        read_hull(ET.fromstring(f'<mesh filename="a.stl">{hull}</mesh>'), "link b")


SHAPE = '<collision><origin xyz="0.2 0 0.05"/><geometry><box size="0.2 0.4 0.1"/></geometry></collision>'


def test_a_link_without_inertial_is_completed_and_told() -> None:
    root = ET.fromstring(ARM.format(shape=SHAPE))
    (told,) = check_inertials(root, "x")[0]
    assert (told.kind, told.place) == ("changed", "tip")
    assert "a guess" in told.sentence
    mass = PLAUSIBLE.density * 0.008
    inertial = read_chain(ET.tostring(root, encoding="unicode")).inertial[0]
    np.testing.assert_allclose(inertial[:4], mass * np.array([1, 0.2, 0, 0.05]), rtol=1e-5, atol=1e-9)
    assert inertial[9] == pytest.approx(mass * ((0.04 + 0.16) / 12 + 0.04), rel=1e-5)
