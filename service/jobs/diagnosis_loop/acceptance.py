"""A user accepts the named effects of a diagnosis into the model of the robot."""

from collections.abc import Mapping, Sequence

from service.diagnosis import model_document
from service.model.errors import BadInput, Conflict
from service.model.results.diagnosis import AxisDiagnosis
from service.model.results.revision import RevisedAxis
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import DiagnosisDocument, ModelDocument
from service.store.store import Store


def accept_model(
    store: Store,
    diagnoses: DiagnosisStore,
    models: ModelStore,
    diagnosis_id: int,
    axes: Sequence[str] | None,
    accepted_by: str,
) -> ModelDocument:
    """The next revision of the robot's model, with the effects of `axes` (None: all axes with something to accept). The
    other axes are copied from the newest revision.

    Conflict if nothing is named and no known effect has changed, all effects were rolled back, the diagnosis already
    became a model, or the newest revision contains more about these axes than the diagnosis did. BadInput for a
    joint that is not in the diagnosis.
    """
    diagnosis = diagnoses.diagnosis(diagnosis_id)
    joints = _acceptable(diagnosis, axes)
    newest = models.newest(diagnosis.robot_id)
    if newest is not None and newest.diagnosis_id != diagnosis_id:
        began = None if diagnosis.model is None else models.model(diagnosis.model)
        for joint in joints:
            if _axes(newest).get(joint) != _axes(began).get(joint):
                raise Conflict(
                    f"{joint}: model {newest.id} was accepted in the meantime, and diagnosis "
                    f"{diagnosis_id} does not start from it; diagnose again from model {newest.id}"
                )
    robot = store.robot(diagnosis.robot_id).build()
    document = model_document(robot, diagnosis.document or {}, joints, None if newest is None else newest.document)
    return models.add(diagnosis_id, accepted_by, document, None if newest is None else newest.id)


def _axes(model: ModelDocument | None) -> Mapping[str, RevisedAxis]:
    return {} if model is None else model.content.axes


def _acceptable(diagnosis: DiagnosisDocument, axes: Sequence[str] | None) -> tuple[str, ...]:
    """The joints whose effects are accepted."""
    found = diagnosis.found("accept").axes
    refusals = {
        joint: _refusal(found[joint]) if joint in found else f"has no result, {diagnosis.cause}"
        for joint in diagnosis.axes
    }
    if axes is None:
        named = tuple(joint for joint, refusal in refusals.items() if not refusal)
        if not named:
            raise Conflict("; ".join(f"{joint}: {refusal}" for joint, refusal in refusals.items()))
        return named
    for joint in axes:
        if joint not in refusals:
            raise BadInput(
                "axes", f"{joint} is not an axis of diagnosis {diagnosis.id}; its axes are {', '.join(diagnosis.axes)}"
            )
        if refusals[joint]:
            raise Conflict(f"{joint}: {refusals[joint]}")
    return tuple(joint for joint in diagnosis.axes if joint in axes)


def _refusal(axis: AxisDiagnosis) -> str:
    """The reason why an axis has nothing to accept, or ""."""
    rolled_back = axis.rolled_back
    if not [effect for effect in axis.effects if effect.effect not in rolled_back] and rolled_back:
        return f"{', '.join(rolled_back)} did not improve held-out sweeps and was rolled back"
    if axis.verdict != "named" and not (axis.verdict in ("none", "untestable") and axis.changes):
        return f"the verdict is {axis.verdict}, not named"
    return ""
