"""Archives of bundles: what they say of themselves is looked at before anything is unpacked."""

import io
import zipfile
from pathlib import Path

import pytest

from service.model.errors import BadInput
from service.store.files.bundle import read_from, write_bundle
from tests.recorded_bundle import bundle


def archive(*names: str, kind: int = zipfile.ZIP_STORED) -> bytearray:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", kind) as made:
        for name in names:
            made.writestr(name, "{}")
    return bytearray(content.getvalue())


def with_a_dictionary_of_4_gib() -> bytearray:
    """LZMA: its size stands in the member itself and was allocated."""
    content = archive("bundle.json", kind=zipfile.ZIP_LZMA)
    properties = content.index(b"bundle.json") + len("bundle.json") + 4
    content[properties + 1 : properties + 5] = b"\xff\xff\xff\xff"
    return content


def of_3_gib_each() -> bytearray:
    content = archive("a", "b")
    for at in (at for at in range(len(content)) if content[at : at + 4] == b"PK\x01\x02"):
        content[at + 24 : at + 28] = (3 * 2**30).to_bytes(4, "little")  # when unpacked
    return content


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (with_a_dictionary_of_4_gib(), r"bundle 'bundle\.json': is compressed by method 14 of zip, which is not read"),
        (archive(*map(str, range(20_001))), "bundle: has 20001 files, limit 20000"),
        (of_3_gib_each(), f"unpacks to {6 * 2**30} bytes, limit {4 * 2**30} bytes"),
    ],
    ids=["memory", "files", "bytes"],
)
def test_an_archive_that_wants_too_much_is_refused(tmp_path: Path, content: bytearray, told: str) -> None:
    (tmp_path / "bundle.zip").write_bytes(content)
    with pytest.raises(BadInput, match=told):
        read_from(tmp_path / "bundle.zip", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["bundle.json", "b/bundle.json", "b\\bundle.json"])
def test_a_bundle_is_found_in_the_folder_that_was_zipped(tmp_path: Path, name: str) -> None:
    write_bundle(tmp_path / "given", bundle().robot, bundle().sweeps)
    with zipfile.ZipFile(tmp_path / "bundle.zip", "w") as made:
        for path in (tmp_path / "given").rglob("*.*"):
            inside = name.replace("bundle.json", str(path.relative_to(tmp_path / "given")))
            made.writestr(inside.replace("/", "\\") if "\\" in name else inside, path.read_bytes())
    assert read_from(tmp_path / "bundle.zip", tmp_path / "out").robot.joints == bundle().robot.joints
