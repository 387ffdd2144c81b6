"""Finds where model and measurement differ, which physical effect is missing, and what to measure next.

`diagnose_axis(robot, joint, sweeps)` diagnoses one axis. `as_document` converts results of axes to one diagnosis,
and `model_document` converts that to a model revision. These are pure functions of the samples: no clock, no files, no
logs. Each name is imported at its first use, so that the service does not load modules that only its worker needs.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from service.diagnosis.diagnose import AxisResult, diagnose_axis
    from service.diagnosis.document import as_document, axis_document, compose
    from service.diagnosis.model.revision import model_document
    from service.diagnosis.rows.signals import is_evidence

_MODULES = {
    "AxisResult": "diagnose",
    "as_document": "document",
    "axis_document": "document",
    "compose": "document",
    "diagnose_axis": "diagnose",
    "is_evidence": "rows.signals",
    "model_document": "model.revision",
}

__all__ = [
    "AxisResult",
    "as_document",
    "axis_document",
    "compose",
    "diagnose_axis",
    "is_evidence",
    "model_document",
]


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
