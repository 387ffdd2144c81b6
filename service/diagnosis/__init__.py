"""Where a model and the measurement disagree, which physical effect is missing, and what to measure next.

`diagnose_axis(robot, joint, sweeps)` does it for one axis, `as_document` makes JSON-able data of it. Pure functions of
the samples: no clock, no files, no logs.
"""

from service.diagnosis.diagnose import AxisDiagnosis, diagnose_axis
from service.diagnosis.document import as_document, axis_document

__all__ = ["AxisDiagnosis", "as_document", "axis_document", "diagnose_axis"]
