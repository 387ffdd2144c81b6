"""The choice of the poses of a plan until its budget is used, and what the estimate will know after each of them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.identification.design.excitation import Excitation
from service.identification.design.pose_selection import PredictedConfidence, choices, conditions, needed
from service.model.errors import BadInput, EnvelopeViolation
from service.planning.documents import LARGEST_CHOICE, USUAL_CHOICE, DroppedPose, PlanRequest
from service.planning.observability import Observation
from service.planning.safety.envelope import Envelope
from service.planning.sweep_design import SweepDesign
from service.planning.sweep_sequence import ChosenPose, least_duration

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Choice:
    """Poses in the order of choice until the budget is used (k), and what is predicted after each (>= k: also after
    the poses that were tried beyond the budget).

    `percent`: confidence by the sweeps alone; `determined`: base parameters (p,) that the estimate determines;
    `refused`: poses that would have been chosen but have no path from home, or no sweep.
    """

    poses: list[ChosenPose]
    percent: list[float]
    determined: list[NDArray[np.bool_]]
    refused: list[DroppedPose]

    @property
    def promised(self) -> list[float]:
        """Confidence that the estimate will state after each pose, percent; inf if it will state none."""
        known = zip(self.percent, self.determined, strict=True)
        return [percent if determined.all() else math.inf for percent, determined in known]

    def enough(self, count: int) -> int | None:
        """Least number of poses beyond `count` that determine everything; None if `count` do, or if none is known."""
        complete = [n for n, determined in enumerate(self.determined, 1) if n >= count and determined.all()]
        return complete[0] if complete and complete[0] > count else None


@dataclass
class _Prediction:
    """The lists of a `Choice` while poses are added."""

    confidence: PredictedConfidence
    percent: list[float] = field(default_factory=list)
    determined: list[NDArray[np.bool_]] = field(default_factory=list)

    def add(self, rows: Array, information: Array) -> None:
        self.confidence.add(rows, information)
        self.percent.append(self.confidence.percent())
        self.determined.append(self.confidence.determined())

    @property
    def all_determined(self) -> bool:
        return bool(self.determined[-1].all())


class PoseChooser:
    """Chooses among the `candidates` (m, n) of a request."""

    def __init__(
        self, request: PlanRequest, envelope: Envelope, design: SweepDesign, observed: Observation, candidates: Array
    ) -> None:
        self._request, self._envelope, self._design = request, envelope, design
        self._observed, self._candidates = observed, candidates
        self._rows = observed.rows(candidates)
        workspace = observed.workspace(candidates)
        inertia = observed.inertia(workspace)
        self._workspace = observed.rows(workspace), inertia, observed.spread(float(inertia.max()))
        self._sweeps: dict[int, tuple[Excitation, ...]] = {}
        self._shown: dict[int, Array] = {}  # information of the sweeps in a candidate

    def choose(self, without: Sequence[DroppedPose]) -> Choice:
        """The poses of the request, none of them `without`; BadInput if the requested confidence is out of reach."""
        request = self._request
        refused = list(without)
        closed = {one.pose for one in without}
        picks = choices(
            *(self._rows, request.criterion, self._candidates, self._observed.home),
            lambda candidate: self._accepted(candidate, closed, refused),
        )
        prediction = self._prediction()
        chosen: list[int] = []
        condition: list[float] = []
        duration, reached = 0.0, False
        for pick, number in picks:
            prediction.add(*self._shows(pick))
            chosen.append(pick)
            condition.append(number)
            duration += request.realisations * least_duration(self._sweeps[pick])
            reached = prediction.percent[-1] <= (request.confidence or 0.0) and prediction.all_determined
            full = len(chosen) == (request.poses or LARGEST_CHOICE) or (request.duration or math.inf) < duration
            if reached or full:
                break
        if request.confidence is not None and chosen:
            if not reached:
                raise BadInput("confidence", self._out_of_reach(request.confidence, len(chosen), prediction.confidence))
            if len(chosen) > 1 and prediction.percent[-2] <= request.confidence:  # continued only to determine all
                shown = [self._shows(pick) for pick in chosen]
                chosen = [chosen[n] for n in needed(prediction.confidence, shown, request.confidence)]
                condition = conditions(self._rows, chosen)
                prediction = self._prediction()
                for pick in chosen:
                    prediction.add(*self._shows(pick))
        reported = refused.copy()  # without those beyond the budget
        while chosen and not prediction.all_determined and len(prediction.determined) < len(chosen) + USUAL_CHOICE:
            beyond = next(picks, None)
            if beyond is None:
                break
            prediction.add(*self._shows(beyond[0]))
        chosen_poses = [
            ChosenPose(self._candidates[pick], number, self._sweeps[pick])
            for pick, number in zip(chosen, condition, strict=True)
        ]
        return Choice(chosen_poses, prediction.percent, prediction.determined, reported)

    def _accepted(self, candidate: int, closed: set[tuple[float, ...]], refused: list[DroppedPose]) -> bool:
        """Whether the candidate has a path from home and its sweeps; otherwise its reason is added to `refused`."""
        pose = tuple(float(position) for position in self._candidates[candidate])
        if pose in closed:
            return False
        if candidate in self._sweeps:
            return True
        try:
            self._envelope.order_of_legs(tuple(self._observed.home), pose)
            self._sweeps[candidate] = tuple(self._design.excitation(joint, candidate) for joint in self._request.axes)
        except (EnvelopeViolation, BadInput) as error:
            refused.append(DroppedPose(pose=pose, reason=str(error)))
            return False
        return True

    def _prediction(self) -> _Prediction:
        return _Prediction(PredictedConfidence(*self._workspace))

    def _shows(self, pick: int) -> tuple[Array, Array]:
        """Rows of an accepted candidate and the information of its sweeps, as `PredictedConfidence.add` takes them."""
        if pick not in self._shown:
            sweeps = zip(self._request.axes, self._sweeps[pick], strict=True)
            once = np.array([self._design.information(joint, pick, sweep) for joint, sweep in sweeps])
            self._shown[pick] = self._request.realisations * once
        return self._rows[pick], self._shown[pick]

    def _out_of_reach(self, wanted: float, count: int, predicted: PredictedConfidence) -> str:
        """What the best poses lack, and for which axes."""
        request = self._request
        best = f"{wanted:.4g} % requested, but the best {count} of {len(self._candidates)} measurable poses"
        unknown = ~predicted.determined()
        percent = predicted.percent_by_axis()
        if not unknown.any():
            return f"{best} reach only {percent.max():.4g} % ({request.axes[int(percent.argmax())]})"
        names = ", ".join(name for name, open_ in zip(self._observed.names, unknown, strict=True) if open_)
        axes = ", ".join(joint for joint, on in zip(request.axes, predicted.depending(unknown), strict=True) if on)
        return (
            f"{best} are not better than CAD for {names}, so the estimate would state no confidence of J; "
            f"J of {axes} depends on them"
        )
