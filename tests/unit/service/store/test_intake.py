"""Archives of bundles: what they say of themselves is looked at before anything is unpacked."""

import zipfile
from pathlib import Path

import pytest

from service.errors import BadInput
from service.store.files.intake import read_from


def test_a_member_that_says_how_much_memory_it_wants_is_refused(tmp_path: Path) -> None:
    """LZMA: the dictionary's size, 4 GiB here, stands in the member itself and was allocated."""
    path = tmp_path / "bundle.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("bundle.json", "{}")
    content = bytearray(path.read_bytes())
    properties = content.index(b"bundle.json") + len("bundle.json") + 4
    content[properties + 1 : properties + 5] = b"\xff\xff\xff\xff"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=r"bundle 'bundle\.json': is compressed by method 14 of zip, which is not read"):
        read_from(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_more_members_than_a_bundle_can_have_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bundle.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(20_001):
            archive.writestr(str(number), "")
    with pytest.raises(BadInput, match="bundle: has 20001 files, limit 20000"):
        read_from(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_sizes_are_summed_before_a_byte_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "bundle.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a", "x")
        archive.writestr("b", "x")
    content = bytearray(path.read_bytes())
    for at in (at for at in range(len(content)) if content[at : at + 4] == b"PK\x01\x02"):
        content[at + 24 : at + 28] = (3 * 2**30).to_bytes(4, "little")  # the size of each when unpacked
    path.write_bytes(content)
    with pytest.raises(BadInput, match=f"unpacks to {6 * 2**30} bytes, limit {4 * 2**30} bytes"):
        read_from(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()
