"""Check of the data before the diagnosis: do recordings, set-points and robot file fit together?

`check(robot, sweeps)` is a pure function. Each kind of finding has one file with one function, which takes all records
of an axis (`record.AxisRecords`) and returns findings. Limits are defined where they are used, with their reason.
"""

from service.data_check.check import check
from service.data_check.finding import DataFinding, findings_document, untrustworthy

__all__ = ["DataFinding", "check", "findings_document", "untrustworthy"]
