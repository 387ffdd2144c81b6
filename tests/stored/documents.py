"""The stored documents of this folder, and others like them, for tests."""

import json
from pathlib import Path
from typing import Any

from service.results.diagnosis import Diagnosis

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
