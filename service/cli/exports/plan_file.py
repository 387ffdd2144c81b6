"""The file of a plan."""

from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from service.model.configuration import bad_field, read_text
from service.planning.documents import PlanDocument


class _PlanFile(BaseModel):
    """What `sweepid plan --out` writes; only the document matters here."""

    model_config = ConfigDict(frozen=True, extra="ignore")
    document: PlanDocument


def read_plan(path: Path) -> PlanDocument:
    """BadInput for a file that `sweepid plan --out` did not write."""
    text = read_text(path)
    try:
        return _PlanFile.model_validate_json(text).document
    except ValidationError as error:
        raise bad_field(str(path), error) from None
