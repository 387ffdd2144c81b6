"""Traces in MATLAB files: read by another process, which a file made to break SciPy takes with it."""

import io
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from service.formats.traces.containers import ChannelName, read_containers
from service.formats.traces.trace_import import import_trace
from service.model.errors import BadInput
from service.store.files.isolated_reader import Limits
from tests.unit.service.test_trace_import import mapping, trace

pytestmark = pytest.mark.slow

LENGTH = 200  # rows of the trace


def written() -> bytes:
    content = io.BytesIO()
    savemat(content, trace())  # pyright: ignore[reportArgumentType]  a file object is taken, by its documentation
    return content.getvalue()


def changed(offset: int, value: int) -> bytes:
    """With another word so many bytes behind the name TORQUE, where its columns, type of data and bytes stand."""
    content = bytearray(written())
    at = content.index(b"TORQUE") + offset
    content[at : at + 4] = value.to_bytes(4, "little")
    return bytes(content)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (changed(8, 14), "the process that read it was ended by SIG"),
        (changed(12, 2**31 - 1), "cannot be read by SciPy"),
        (changed(-12, 2**31 - 1), "limit 50000000 numbers"),
        (changed(-16, 2**31 - 1), "limit 50000000 numbers"),
        (written()[:121], "cannot be read by SciPy: index out of range"),
        (b"PK\x03\x04", "cannot be read by SciPy: Mat file appears to be truncated"),
        (b"", "cannot be read by SciPy: Mat file appears to be truncated"),
        (
            b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM",
            "cannot be read by h5py: Unable to synchronously open file",
        ),
    ],
)
def test_a_file_made_to_break_its_reader_is_one_error(content: bytes, reason: str, tmp_path: Path) -> None:
    (tmp_path / "trace.mat").write_bytes(content)
    with pytest.raises(BadInput) as refusal:
        import_trace(mapping(tmp_path, "trace.mat"))
    assert reason in str(refusal.value)
    assert "trace.mat" in str(refusal.value)


@pytest.mark.slow
def test_a_compressed_file_that_unfolds_meets_the_limit_of_memory(tmp_path: Path) -> None:
    """1 MB of zeros stands for 400 MB."""
    path = tmp_path / "trace.mat"
    savemat(path, {"TORQUE": np.zeros(MOST)}, do_compression=True)
    assert path.stat().st_size < 2_000_000
    asked = [(ChannelName(source="TORQUE", group=None),)]
    with pytest.raises(BadInput, match="needs more memory than the limit of 629145600 bytes"):
        read_containers(path, asked, Limits(memory=600 * 2**20))


MOST = 50_000_000
