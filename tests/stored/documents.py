"""The stored documents of this folder, and others like them, for tests."""

import json
from pathlib import Path
from typing import Any

from service.model.results.diagnosis import Diagnosis

HERE = Path(__file__).parent


def stored(name: str) -> Any:
    """A document as a command wrote it."""
    return json.loads((HERE / f"{name}.json").read_text("utf-8"))


def axis_document(effects: tuple[str, ...] | None = None, **changes: Any) -> dict[str, Any]:
    """A diagnosed axis with something else in it; `effects` by name."""
    axis = stored("diagnosis-named")["axes"]["joint_1"]
    if effects is not None:
        changes["effects"] = [axis["effects"][0] | {"effect": name} for name in effects]
    return axis | changes


def diagnosis_document(**axes: dict[str, Any]) -> dict[str, Any]:
    """A diagnosis of these axes."""
    return stored("diagnosis-named") | {"axes": axes}


def diagnosis(**axes: dict[str, Any]) -> Diagnosis:
    """The same, read."""
    return Diagnosis.read(diagnosis_document(**axes), "diagnosis")


def payload() -> dict[str, Any]:
    """As `sweepid estimate payload --json` writes it."""
    known = {"value": 12.0, "std": 0.1, "std_total": 0.3, "excited": True}
    inertia = {"Ixx": 0.3, "Ixy": 0.02, "Ixz": 0.0, "Iyy": 0.25, "Iyz": 0.01, "Izz": 0.2}
    center = {"x": 0.01, "y": 0.0, "z": 0.15}
    near = {"mass": 12.0, "center": [*center.values()], "inertia": inertia}
    return {
        **{"link": "link_6", "frame": "joint_6", "mass": known},
        "center": {name: known | {"value": value} for name, value in center.items()},
        "inertia": {name: known | {"value": value} for name, value in inertia.items()},
        "parameters": {"names": ["m"], "values": [12.0], "covariance": [[0.01]], "covariance_total": [[0.09]]},
        "physical": {"consistent": True, "deviation_in_std": 0.0, "nearest": near},
        "evidence": [{"axis": "joint_6", "from": "sweeps"}],
        "sentences": [],
    }
