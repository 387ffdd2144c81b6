"""Searches of a diagnosis that used up their steps. They are warnings, not errors: what the model leaves over the noise
floor decides the verdict.
"""

from collections.abc import Iterator

from service.diagnosis.fit.calibration import WeighedGain
from service.diagnosis.fit.cross_products import Ended
from service.diagnosis.fit.select import Selection
from service.diagnosis.summary import in_words
from service.identification.model import unsettled
from service.model.results.diagnosis import Unfinished

READ = "Its parameters may be further off than their standard deviations: compare the gap after with the noise floor."
MORE_SWEEPS = "Repeat the sweeps with the test mass, or take a heavier one."


def unfinished(joint: str, selection: Selection, weighed: WeighedGain | None) -> tuple[Unfinished, ...]:
    """The searches of the chosen explanation, also of effects that are not named, and of a gain by test mass."""
    return tuple(_all(joint, selection, weighed))


def _all(joint: str, selection: Selection, weighed: WeighedGain | None) -> Iterator[Unfinished]:
    for term in selection.chosen.terms:
        if term.ended is Ended.UNFINISHED:
            what = f"the search of the shape of {in_words([term.effect])} used up its steps"
            yield Unfinished(effect=term.effect, sentence=f"{joint}: {what}; {Ended.UNFINISHED.value}.", action=READ)
    if selection.ended is Ended.UNFINISHED:
        what = "the fits of the load and of the shapes of the effects in turn used up their rounds"
        yield Unfinished(effect=None, sentence=f"{joint}: {what}; {Ended.UNFINISHED.value}.", action=READ)
    change = None if weighed is None else unsettled(weighed.noise_change)
    if change is not None:
        told = f"{joint}: of the gain by the test mass, {change}."
        yield Unfinished(effect="torque_constant_error", sentence=told, action=MORE_SWEEPS)
