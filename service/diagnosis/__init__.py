"""Where a model and the measurement disagree, which physical effect is missing, and what to measure next.

`diagnose_axis(robot, joint, sweeps)` does it for one axis, `as_document` makes JSON-able data of it, `model_document`
a model revision of that. Pure functions of the samples: no clock, no files, no logs.
"""

from service.diagnosis.diagnose import AxisDiagnosis, diagnose_axis
from service.diagnosis.document import as_document, axis_document, compose
from service.diagnosis.model.revision import model_document
from service.diagnosis.rows.signals import is_evidence
from service.diagnosis.start import started_from

__all__ = [
    "AxisDiagnosis",
    "as_document",
    "axis_document",
    "compose",
    "diagnose_axis",
    "is_evidence",
    "model_document",
    "started_from",
]
