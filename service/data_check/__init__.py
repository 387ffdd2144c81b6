"""A check of the data before any physics: do the recordings, the set-points and the robot file fit together?

`check(robot, sweeps)` is a pure function. Each kind of finding is one file with one function, which gets all records of
an axis (`record.AxisRecords`) and returns findings. Limits stand where they are used, with their reason.
"""

from service.data_check.check import check
from service.data_check.document import findings_document
from service.data_check.finding import Finding, untrustworthy

__all__ = ["Finding", "check", "findings_document", "untrustworthy"]
