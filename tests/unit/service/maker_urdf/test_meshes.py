"""Points of mesh files: the three kinds, what is incomplete or no number, and folders that are not to be left."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from service import BadInput
from service.formats.maker_urdf import packages
from service.formats.maker_urdf.packages import MeshLimits, Packages, mesh_points

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])


def binary_stl(triangles: list[list[int]], head: bytes = b"solid as some makers write") -> bytes:
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *CORNERS[list(corners)].ravel(), 0) for corners in triangles)
    return head.ljust(80) + struct.pack("<I", len(triangles)) + body


TEXT_STL = (
    b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nVERTEX 0 2 0\nendloop\nendfacet\nendsolid"
)
OBJ = b"# comment\nvn 0 0 1\nv 0 0 0 1.0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n"


def dae(node: str, *, unit: str = "0.01", used: str = "0 1 2") -> bytes:
    return f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"><asset><unit meter="{unit}"/></asset>
    <library_geometries><geometry id="g"><mesh>
    <source id="p"><float_array id="a" count="12">0 0 0 1 0 0 0 2 0 0 0 3</float_array>
    <technique_common><accessor source="#a" stride="3"/></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/>
    <input semantic="NORMAL" source="#p" offset="1"/><p>{" ".join(f"{k} 0" for k in used.split())}</p></triangles>
    </mesh></geometry></library_geometries>
    <library_visual_scenes><visual_scene id="s"><node>{node}<instance_geometry url="#g"/></node></visual_scene>
    </library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>""".encode()


@pytest.mark.parametrize(
    ("content", "name"),
    [(binary_stl([[0, 1, 2]]), "a.STL"), (TEXT_STL, "a.stl"), (OBJ, "a.obj"), (dae("", unit="1"), "a.dae")],
    ids=["binary", "text", "obj", "dae"],
)
def test_each_kind_gives_its_points(content: bytes, name: str) -> None:
    np.testing.assert_array_equal(np.unique(mesh_points(content, name, "x"), axis=0), np.unique(CORNERS[:3], axis=0))


def test_the_scene_of_a_dae_places_scales_and_turns() -> None:
    node = "<translate>5 0 0</translate><rotate>0 0 1 90</rotate><scale>2 2 2</scale>"
    expected = 0.01 * (2 * CORNERS[:3] @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + [5, 0, 0])
    np.testing.assert_allclose(mesh_points(dae(node), "a.dae", "x"), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("content", "name", "told"),
    [
        (binary_stl([[0, 1, 2]], b"\0")[:-7], "a.stl", "is incomplete: 1 triangles declared in 127 bytes"),
        (b"", "a.stl", "is incomplete"),
        (b"solid nothing", "a.stl", "has no points"),
        (b"v 1 2\n", "a.obj", "fewer than three numbers"),
        (b"v 1 2 x\n", "a.obj", "could not convert"),
        (b"v 1 2 nan\n", "a.obj", "not finite"),
        (b"<COLLADA>", "a.dae", "not XML"),
        (b'<?xml version="1.0" encoding="hex"?><COLLADA/>', "a.dae", "cannot be read"),
        (b"<COLLADA/>", "a.dae", "has no visual scene"),
        (dae("<matrix>1 2 3</matrix>"), "a.dae", "cannot be read"),
        (dae("", used="0 1 9"), "a.dae", "cannot be read"),
        (b"", "a.step", "is not one of .stl, .obj, .dae"),
    ],
)
def test_what_is_no_mesh_is_told(content: bytes, name: str, told: str) -> None:
    with pytest.raises(BadInput, match=f"(?s)a\\..*{told}"):
        mesh_points(content, name, "x")


def nodes(levels: int, inner: str = "") -> bytes:
    """Each node shows the next one twice."""
    made = "".join(
        f'<node id="n{k}"><instance_node url="#n{k + 1}"/><instance_node url="#n{k + 1}"/></node>'
        for k in range(levels)
    )
    return dae(f'{made}<node id="n{levels}">{inner}</node>')


VERTICES = b'<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
POSITIONS = VERTICES.replace(b"/></", b'/><input semantic="POSITION" source="#p"/></')
SHOWN = nodes(5, '<instance_geometry url="#g"/>')


def test_a_geometry_that_is_shown_often_is_read_once() -> None:
    assert len(np.unique(mesh_points(SHOWN, "a.dae", "x"), axis=0)) == 3


@pytest.mark.parametrize(
    ("content", "limits", "told"),
    [
        (nodes(60), MeshLimits(), "shows more than 10000 nodes and geometries"),  # 2^60 nodes, which hold nothing
        (SHOWN, MeshLimits(shown=20), "shows more than 20 points"),
        (
            b'<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>' + dae("&b;"),
            MeshLimits(),
            "declares a DOCTYPE; ent",
        ),
        (dae(""), MeshLimits(elements=10), "has more than 10 elements"),
        (dae("").replace(VERTICES, VERTICES * 3), MeshLimits(), "a geometry has 3 <vertices> with 3 positions; one of"),
        (dae("").replace(VERTICES, POSITIONS), MeshLimits(), "a geometry has 1 <vertices> with 2 positions; one of"),
    ],
)
def test_a_scene_has_its_limits(content: bytes, limits: MeshLimits, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages, "LIMITS", limits)
    with pytest.raises(BadInput, match=told):
        mesh_points(content, "a.dae", "x")


@pytest.mark.slow
def test_text_meshes_take_no_more_memory_than_some_copies_of_the_file() -> None:
    """As lists of words they took thirty times the file."""
    content = b"v 1 2 3\r" * 500_000
    tracemalloc.start()
    assert mesh_points(content, "a.obj", "x").shape == (500_000, 3)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 75e6


def test_too_many_points_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages, "LIMITS", MeshLimits(points=2))
    assert len(mesh_points(b"v 1 2 3\nv 0 0 0\n" * 2, "a.obj", "x")) == 2
    with pytest.raises(BadInput, match="has 3 different points, limit 2; make it coarser"):
        mesh_points(OBJ, "a.obj", "x")


@pytest.fixture
def share(tmp_path: Path) -> Path:
    (tmp_path / "share/arm/meshes").mkdir(parents=True)
    (tmp_path / "share/arm/meshes/a.obj").write_bytes(OBJ)
    (tmp_path / "secret.obj").write_bytes(b"v 9 9 9")
    (tmp_path / "share/arm/out.obj").symlink_to(tmp_path / "secret.obj")
    (tmp_path / "share/arm/circle.obj").symlink_to(tmp_path / "share/arm/circle.obj")
    return tmp_path / "share"


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("package://arm/../../secret.obj", "'..' leads out of a package"),
        ("package://arm/..\\..\\secret.obj", "'..' leads out of a package"),
        ("package://arm/out.obj", "lies outside of the package folders"),
        ("package://arm/circle.obj", "no such file"),
        ("package://other/a.obj", "no such file in the package folders"),
        ("package://arm", "is not package://PACKAGE/FILE"),
        ("package://arm/meshes", "is not a file"),
        ("package://arm/\0", "no such file"),
        ("file:///etc/passwd", "lies outside of the package folders"),
        ("http://x/a.stl", "only package://PACKAGE/FILE or a path beside the URDF"),
        ("/etc/passwd", "lies outside"),
        ("secret.obj", "lies outside"),
    ],
)
def test_nothing_outside_of_the_packages_is_read(share: Path, name: str, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        Packages([share], share.parent).read(name, "link a")


def test_a_mesh_larger_than_the_limit_is_refused(share: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages, "LIMITS", MeshLimits(size=len(OBJ) - 1))
    with pytest.raises(BadInput, match="is larger than"):
        Packages([share], share).read("package://arm/meshes/a.obj", "x")


def test_a_package_folder_that_is_none_is_told(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="is not a folder of packages"):
        Packages([tmp_path / "nowhere"], tmp_path)
