"""The verdict of one axis in one or two sentences; the same text on the command line, in the report and on the page."""

from collections.abc import Sequence

from service.model.results.diagnosis import AxisDiagnosis, Gap


def summary(joint: str, axis: AxisDiagnosis, ended: str = "") -> str:
    """The summary from the document of the axis; `ended`: why nothing more can be measured, or ""."""
    end = f" It cannot be diagnosed further, because {ended}." if ended else ""
    return f"{joint}: {_VERDICTS[axis.verdict](axis)}{_rolled_back(axis.rolled_back)}{end}"


def in_words(effects: Sequence[str], between: str = "and") -> str:
    """Names of effects, as an enumeration for a sentence."""
    words = [
        effect.replace("_", " ").replace("coulomb", "Coulomb").replace("stribeck", "Stribeck") for effect in effects
    ]
    parts = [", ".join(words[:-1]), *words[-1:]]
    return f" {between} ".join(part for part in parts if part)


def _none(axis: AxisDiagnosis) -> str:
    left = f"what it leaves of the drive's effort, {_rms(axis, 'before')}, is noise{_floor(axis, ' ({})')}."
    if axis.changes:
        return f"the model lacks no effect, but {_changed(axis)}. With that, {left}"
    return f"the model is right as far as these sweeps can tell: {left}"


def _named(axis: AxisDiagnosis) -> str:
    names = [effect.effect for effect in axis.effects]
    where = judged_on(axis.gap)
    text = (
        f"the model lacks {in_words(names)}. With {'it' if len(names) == 1 else 'them'} the gap {where} falls from "
        f"{_rms(axis, 'before')} to {_rms(axis, 'after')}{_floor(axis, '; the noise alone makes {}')}."
    )
    return f"{text} Also {_changed(axis)}." if axis.changes else text


def _ambiguous(axis: AxisDiagnosis) -> str:
    advice = " Next: measure the proposed experiment." if axis.next_experiment else ""
    open_questions = [in_words(names, "or") for names in axis.alternatives if len(names) > 1]
    undecided = {name for names in axis.alternatives for name in names}
    certain = [effect.effect for effect in axis.effects if effect.effect not in undecided]
    certain += [names[0] for names in axis.alternatives if len(names) == 1]
    beside = f" Significant: {in_words(certain)}." if certain and open_questions else ""
    asked = ", nor whether it is ".join(open_questions) or in_words(certain, "or")
    return (
        f"something is missing, a gap of {_rms(axis, 'before')}{_floor(axis, ' where noise makes {}')}, and these "
        f"sweeps do not tell whether it is {asked}.{beside}{advice}"
    )


def _unknown(axis: AxisDiagnosis) -> str:
    wrong = [finding.sentence for finding in axis.data if finding.severity == "wrong"]
    if wrong:
        return f"no physics is named, because the data cannot be trusted. {' '.join(wrong)} Correct this first."
    measured = f"{in_words([e.effect for e in axis.effects])} apart, " if axis.effects else ""
    known = f" Known in part: {in_words([effect.effect for effect in axis.part])}." if axis.part else ""
    return (
        f"{measured}there is a gap of {_rms(axis, 'after')} that is more than noise{_floor(axis, ' ({})')}, and no "
        f"effect of the catalogue explains it.{known} The model stays as it was."
    )


def _untestable(axis: AxisDiagnosis) -> str:
    reasons = [] if axis.has_noise_floor else ["no sweep was repeated, so there is no noise floor to compare with"]
    if axis.biasing:
        reasons.append(f"they cannot show {in_words(axis.biasing)}, which would change the estimate unseen")
    why = f" ({'; '.join(reasons)})" if reasons else ""
    advice = ": measure the proposed experiment next" if axis.next_experiment else ""
    changed = f" But {_changed(axis)}." if axis.changes else ""
    return f"these sweeps cannot show whether something is missing{why}{advice}.{changed}"


def _changed(axis: AxisDiagnosis) -> str:
    """The parameters of known effects in the model, and their present values."""
    changes = [
        f"{in_words([change.effect])} has changed: {change.parameter.replace('_', ' ')} is "
        f"{change.now.value:.4g} ± {change.now.std:.2g}, not {change.model.value:.4g} "
        f"{change.now.unit}".rstrip()
        for change in axis.changes
    ]
    return " and ".join(changes)


_VERDICTS = {
    "none": _none,
    "named": _named,
    "ambiguous": _ambiguous,
    "unknown": _unknown,
    "untestable": _untestable,
}


def _rolled_back(effects: Sequence[str]) -> str:
    if not effects:
        return ""
    return f" Rolled back, because held-out sweeps came out no better: {in_words(effects)}."


def judged_on(gap: Gap) -> str:
    """The sweeps on which the gap was computed."""
    if gap.held_out_sweeps:
        return "on sweeps that took no part in naming or fit"
    if gap.cross_validated:
        return "(cross-validated)"
    return "(on the sweeps themselves: none could be left out)"


def _rms(axis: AxisDiagnosis, when: str) -> str:
    gap = axis.gap
    before, after = (gap.before_rms, gap.before_percent), (gap.after_rms, gap.after_percent)
    rms, percent = before if when == "before" else after
    return f"{rms:.3g} {axis.unit} ({percent:.3g} % of the effort)"


def _floor(axis: AxisDiagnosis, text: str) -> str:
    """Insert the noise floor into a text; empty if no sweep was repeated."""
    floor = axis.gap.noise_floor_rms
    return "" if floor is None else text.format(f"{floor:.3g} {axis.unit}")
