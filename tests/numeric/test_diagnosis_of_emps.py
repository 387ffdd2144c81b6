"""A measured axis: the EMPS record, started from inertia and viscous friction alone."""

from pathlib import Path
from typing import Any

from service.diagnosis import axis_document, diagnose_axis
from service.formats.traces.trace_import import import_trace


def test_friction_that_differs_with_the_direction_is_named_first(root: Path, shared: Path) -> None:
    """Janot, Gautier and Brunot (2019): Fc = 20.39 N; their asymmetry and offset are one effect here."""
    robot, sweeps = import_trace(root / "config/traces/emps.yaml", shared / "data/emps/DATA_EMPS.mat")
    document: Any = axis_document(diagnose_axis(robot, "slide", sweeps)).as_json()
    assert document["verdict"] == "named"
    first = document["effects"][0]
    assert first["effect"] in ("coulomb_friction", "asymmetric_friction")
    coulomb = first["parameters"]["coulomb"]["value"]
    gap = document["gap"]
    print(f"EMPS: Fc = {coulomb:.2f} N, gap {gap['before_percent']:.1f} % -> {gap['after_percent']:.1f} %")
    assert abs(coulomb / 20.39 - 1) < 0.05
    assert 15 < gap["before_percent"] < 20
    assert gap["after_percent"] < 4
