"""Files of the shared data that people could not read, as their README says; skipped without that data."""

from pathlib import Path

import pytest

import sweepid
from service.formats.traces.trace_import import import_trace

pytestmark = pytest.mark.slow

MAPPED = [("C01_twincat_scope_csv", "map.yaml"), ("C03_suffix", "map.yaml"), ("C03_suffix", "map2.yaml"),
          ("C04_cp1252_names", "map.yaml"), ("C05_blank_after_comma", "map.yaml")]  # fmt: skip


def everyday(shared: Path, name: str) -> Path:
    folder = shared / "data/everyday" / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    return folder


@pytest.mark.parametrize(("name", "file"), MAPPED)
def test_a_mapping_reads_them(shared: Path, name: str, file: str) -> None:
    robot, sweeps = import_trace(everyday(shared, name) / file)
    assert robot.joints == ("c",)
    assert sweeps[0].recording.position[1] == pytest.approx(0.007539)


@pytest.mark.parametrize(
    ("name", "file", "known"),
    [
        ("C01_twincat_scope_csv", "trace.csv", {}),
        ("C03_suffix", "TRACE.CSV", {}),
        ("C04_cp1252_names", "trace.csv", {}),
        ("C06_matrix_per_signal", "trace.mat", {"axis": "0"}),
        ("G01_solution_line_trace", "trace.xml", {}),
    ],
)
def test_they_show_4_kg_m2_without_a_mapping(shared: Path, name: str, file: str, known: dict[str, str]) -> None:
    told: list[str] = []
    estimate = sweepid.identify(sweepid.import_trace(everyday(shared, name) / file, tell=told.append, **known))
    assert estimate["value"][0] == pytest.approx(4.0, rel=2e-3)
    assert told
