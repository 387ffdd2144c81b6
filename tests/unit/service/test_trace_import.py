"""Trace exports to bundles: made-up traces whose truth is known, and the recorded EMPS axis."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.io import savemat

from service import BadInput
from service.formats.traces.trace_import import differentiate, import_trace
from service.store.files.bundle import write_bundle

pytestmark = pytest.mark.slow

TABLE: dict[str, object] = {
    **{"name": "table", "joint": "c", "kind": "revolute", "inertia": 4.0},
    **{"lower": -10.0, "upper": 10.0, "velocity": 2.0, "rated_effort": 50.0},
}
SWEEP = {
    **{"id": "0001", "axis": "c", "pose": [1.0], "offset_velocity": 0.0},
    **{"excitation": "trajectory", "sample_rate": 1000},
}


def mapping(folder: Path, source: str, **changes: object) -> Path:
    """A mapping file for one sweep of a turning table; `changes` replace whole parts of it."""
    content: dict[str, object] = {
        "robot": TABLE,
        "columns": {
            "time": {"source": "CYCLE", "scale": 0.001},
            "effort": {"source": "TORQUE", "scale": 20.0},
            "velocity": {"source": "SPEED"},
            "position": {"source": "ENC", "scale": 0.017453292519943295, "offset": 1.0},
        },
        "sweeps": [{"source": source, **SWEEP}],
    }
    path = folder / "mapping.yaml"
    path.write_text(yaml.safe_dump(content | changes))
    return path


def trace() -> dict[str, np.ndarray]:
    cycle = np.arange(200)
    return {"CYCLE": cycle + 7.0, "TORQUE": 0.1 * cycle, "SPEED": 0.5 * cycle, "ENC": 90.0 + 0.01 * cycle}


def write_csv(
    path: Path, columns: dict[str, np.ndarray], delimiter: str = ",", point: str = ".", head: str = ""
) -> None:
    rows = zip(*columns.values(), strict=True)
    lines = [delimiter.join(columns)] + [
        delimiter.join(f"{value:.6f}" for value in row).replace(".", point) for row in rows
    ]
    path.write_text(head + "\n".join(lines) + "\n")


def test_scales_and_offsets_apply(tmp_path: Path) -> None:
    write_csv(tmp_path / "plain.csv", trace())
    write_csv(tmp_path / "german.csv", trace(), ";", ",", "Werkzeugmaschine 7\nNC-Trace\n")
    savemat(tmp_path / "trace.mat", trace())
    german = {"csv": {"delimiter": ";", "decimal_point": ",", "skip_rows": 2}}
    for source, form in (("plain.csv", {}), ("german.csv", german), ("trace.mat", {})):
        robot, (sweep,) = import_trace(mapping(tmp_path, source, **form))
        np.testing.assert_allclose(sweep.recording.time, np.arange(200) / 1000, atol=1e-9)
        np.testing.assert_allclose(sweep.recording.effort, 2.0 * np.arange(200), atol=1e-9)
        np.testing.assert_allclose(sweep.recording.velocity, 0.5 * np.arange(200), atol=1e-9)
        np.testing.assert_allclose(sweep.recording.position, 1.0 + np.radians(90.0 + 0.01 * np.arange(200)))
        assert robot.joints == ("c",)
        assert robot.chain.inertial[0, 4] == 4.0  # about x, the axis


def test_a_trace_with_a_gap_is_not_written(tmp_path: Path) -> None:
    savemat(tmp_path / "trace.mat", {name: np.delete(column, 50) for name, column in trace().items()})
    robot, sweeps = import_trace(mapping(tmp_path, "trace.mat"))
    with pytest.raises(BadInput, match=r"gap in time: 0\.051 s follows 0\.049 s"):
        write_bundle(tmp_path / "bundle", robot, sweeps)
    assert not (tmp_path / "bundle").exists()


def low_pass(corner: float) -> dict[str, object]:
    columns = {"effort": {"source": "TORQUE"}, "position": {"source": "ENC"}}
    return {"columns": columns | {"velocity": {"from_position": corner}}}


def robot(**changes: object) -> dict[str, object]:
    return {"robot": TABLE | changes}


@pytest.mark.parametrize(
    ("source", "changes", "reason"),
    [
        ("none.csv", {}, "none.csv: file does not exist"),
        ("none.mat", {}, "none.mat: file does not exist"),
        ("mapping.yaml", {}, "mapping.yaml: has no table of numbers; it begins with 'columns:'"),
        ("torn.mat", {}, "torn.mat: cannot be read"),
        ("text.mat", {}, "variable 'TORQUE': is not a column of numbers"),
        ("trace.mat", {"robots": "x"}, "robots: unknown key; did you mean robot?"),
        ("trace.mat", {"robot": "robot.yaml"}, "robot.yaml: cannot be read"),
        ("trace.mat", {"robot": {"name": "table"}}, "robot.axis.joint: Field required"),
        ("trace.mat", {"sweeps": []}, "sweeps: Tuple should have at least 1 item"),
        ("trace.mat", {"columns": {"effort": {"source": "M"}}}, "has no variable 'M'; there are CYCLE, TORQUE, SPEED"),
        ("trace.mat", low_pass(0), "velocity.derived.from_position: Input"),
        ("trace.mat", low_pass(600), "is not below half the sample rate"),
        ("trace.mat", low_pass(5), "200 samples are too few for a low-pass of 5.0 Hz"),
        ("trace.mat", low_pass(5e-324), "200 samples are too few for a low-pass of 5e-324 Hz"),
        ("trace.mat", robot(rated_effort=5e-324), "mapping.yaml robot rated_effort: Input should be"),
        ("trace.mat", robot(gear_ratio=1e308), "robot gear_ratio: Value error, must be between"),
        ("trace.mat", robot(name="a\x07b"), "robot.axis.name: String should match pattern"),
        ("trace.mat", {"csv": {"skip_rows": 2**31}}, "csv.skip_rows: Input should be less than or equal to 1000000"),
        ("lengths.mat", {}, "differ in length, nothing is resampled: CYCLE has 200, TORQUE has 3"),
    ],
)
def test_refusals_name_the_reason(tmp_path: Path, source: str, changes: dict[str, object], reason: str) -> None:
    savemat(tmp_path / "trace.mat", trace())
    savemat(tmp_path / "text.mat", trace() | {"TORQUE": "low"})
    savemat(tmp_path / "lengths.mat", trace() | {"TORQUE": np.arange(3.0)})
    (tmp_path / "torn.mat").write_bytes((tmp_path / "trace.mat").read_bytes()[:900])
    with pytest.raises(BadInput) as refusal:
        import_trace(mapping(tmp_path, source, **changes))
    assert reason in str(refusal.value)


@pytest.mark.parametrize(("frequency", "bound"), [(0.5, 1e-9), (5.0, 1e-9), (20.0, 4e-6)])
def test_derivative_has_neither_phase_nor_bias(frequency: float, bound: float) -> None:
    omega, time = 2 * np.pi * frequency, np.arange(8000) / 1000
    inner = slice(2000, 6000)  # whole periods; the ends are extrapolated
    measured = np.exp(-1j * omega * time)[inner] @ differentiate(np.sin(omega * time), 1000.0, 100.0)[inner] / 2000
    assert abs(measured / omega - 1) < bound


def test_derivative_keeps_a_straight_line_to_its_ends() -> None:
    np.testing.assert_allclose(differentiate(3.0 * np.arange(500) / 1000 + 2, 1000.0, 100.0), 3.0, rtol=1e-8)
