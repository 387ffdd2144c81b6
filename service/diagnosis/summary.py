"""The verdict of one axis in a sentence or two, the same on the command line, in the report and on the page."""

from collections.abc import Mapping, Sequence
from typing import Any


def summary(joint: str, axis: Mapping[str, Any]) -> str:
    """From the axis' document."""
    return f"{joint}: {_VERDICTS[axis['verdict']](axis)}{_rolled_back(axis.get('rolled_back', ()))}"


def in_words(effects: Sequence[str], between: str = "and") -> str:
    """Effects by their names, as a list in a sentence."""
    words = [
        effect.replace("_", " ").replace("coulomb", "Coulomb").replace("stribeck", "Stribeck") for effect in effects
    ]
    parts = [", ".join(words[:-1]), *words[-1:]]
    return f" {between} ".join(part for part in parts if part)


def _none(axis: Mapping[str, Any]) -> str:
    return (
        "the model is right as far as these sweeps can tell: what it leaves of the drive's effort, "
        f"{_rms(axis, 'before')}, is noise ({_floor(axis)})."
    )


def _named(axis: Mapping[str, Any]) -> str:
    names = [effect["effect"] for effect in axis["effects"]]
    return (
        f"the model lacks {in_words(names)}. With {'it' if len(names) == 1 else 'them'} the gap on held-out "
        f"sweeps falls from {_rms(axis, 'before')} to {_rms(axis, 'after')}; the noise alone makes {_floor(axis)}."
    )


def _ambiguous(axis: Mapping[str, Any]) -> str:
    told = "Measure what is proposed next" if axis["next_experiment"] else "No sweep that is left to measure tells them"
    return (
        f"something is missing, a gap of {_rms(axis, 'before')} where noise makes {_floor(axis)}, and these sweeps do "
        f"not tell whether it is {in_words(axis['candidates'], 'or')}. {told}."
    )


def _unknown(axis: Mapping[str, Any]) -> str:
    return (
        f"there is a repeatable gap of {_rms(axis, 'before')} where noise makes {_floor(axis)}, and no effect of the "
        "catalogue explains it. The model stays as it was."
    )


def _untestable(axis: Mapping[str, Any]) -> str:
    return "these sweeps cannot show what may be missing: measure what is proposed next."


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


def _rms(axis: Mapping[str, Any], when: str) -> str:
    gap = axis["gap"]
    return f"{gap[f'{when}_rms']:.3g} {axis['unit']} ({gap[f'{when}_percent']:.2g} % of the effort)"


def _floor(axis: Mapping[str, Any]) -> str:
    return f"{axis['gap']['noise_floor_rms']:.3g} {axis['unit']}"
