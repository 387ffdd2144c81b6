"""The verdict of the report of a campaign in one sentence: result of the estimate, and objections."""

from collections.abc import Sequence
from dataclasses import dataclass

from service.model.results.diagnosis import DataCheck, Diagnosis, standing_of
from service.model.results.estimate import UNSURE, Estimate, share_of_value
from service.report.diagnosis import plain

CONFIRMED, OPEN, CONTRADICTED = "Confirmed", "Not confirmed", "Contradicted"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict on the estimate (one of the three words above) and the reasons; one sentence each."""

    standing: str
    sentence: str


def verdict(
    estimate: Estimate,
    check: DataCheck | None,
    diagnosis: tuple[int, Diagnosis] | None,
    test_mass: float | None = None,
) -> Verdict:
    """The verdict from an estimate, the findings of the data check, and number and document of the newest diagnosis."""
    parts = (_estimate(estimate), _mass(test_mass), _check(check), _diagnosis(estimate, diagnosis))
    standings = {standing for standing, _ in parts}
    standing = next(one for one in (CONTRADICTED, OPEN, CONFIRMED) if one in standings)
    return Verdict(standing, f"{'; '.join(sentences for _, sentences in parts if sentences)}.")


def _estimate(estimate: Estimate) -> tuple[str, str]:
    shares = {joint: share_of_value(axis) for joint, axis in estimate.axes.items()}
    if not shares:
        return OPEN, "No inertia of a single axis was identified, only the results below"
    unsure = [joint for joint, share in shares.items() if not share <= UNSURE]
    sure = [joint for joint in shares if joint not in unsure]
    sentences: list[str] = []
    if sure:
        worst = max(sure, key=lambda joint: shares[joint])
        sentences.append(
            f"{_inertias(sure)} known to {100 * shares[worst]:.2g} % or better"
            " (one standard deviation, with that of the torque constants"
            f"{f'; {worst} is the least accurate' if len(sure) > 1 else ''})"
        )
    if unsure:
        sentences.append(f"{_inertias(unsure)} too uncertain to use")
    suspects = estimate.suspect
    if suspects:
        sentences.append(f"{_count(len(suspects), 'sweep does', 'sweeps do')} not fit the others")
    text = ", but ".join(sentences)
    open_ = sum(entry.std is None for entry in estimate.base_parameters)
    if open_:
        text += f"; the sweeps do not identify {open_} of {len(estimate.base_parameters)} base parameters"
    return (OPEN if unsure or suspects else CONFIRMED), text[:1].upper() + text[1:]


def _mass(test_mass: float | None) -> tuple[str, str]:
    if test_mass is None:
        return CONFIRMED, ""
    return OPEN, f"a test mass of {test_mass:g} kg was mounted, so this is not the bare robot"


def _check(check: DataCheck | None) -> tuple[str, str]:
    if check is None:
        return OPEN, "the data were not checked yet"
    wrong = [one for one in check.findings if one.severity == "wrong"]
    if wrong:
        codes = sorted({f"{one.code.replace('_', ' ')} of {one.axis or 'the robot'}" for one in wrong})
        return CONTRADICTED, f"but the data check says that the data cannot be trusted ({', '.join(codes)})"
    warnings = len(check.findings)
    return (
        CONFIRMED,
        f"the data check found {_count(warnings, 'warning', 'warnings') if warnings else 'nothing'}",
    )


def _diagnosis(estimate: Estimate, diagnosis: tuple[int, Diagnosis] | None) -> tuple[str, str]:
    """An effect that is included in the estimate is not missing from it."""
    if diagnosis is None:
        return OPEN, "no diagnosis was made"
    number, document = diagnosis
    taken = {(one.axis, one.effect) for one in estimate.effects if one.used}
    against: list[str] = []
    untold: list[str] = []
    for joint, axis in document.axes.items():
        if joint not in estimate.axes:
            continue
        effects = [one.effect for one in axis.effects if (joint, one.effect) not in taken]
        if axis.verdict == "named" and effects:
            against.append(f"the model of {joint} lacks {_list([plain(effect) for effect in effects])}")
        elif axis.verdict == "ambiguous":
            against.append(f"the model of {joint} lacks an effect that is not named yet")
        elif axis.verdict == "unknown":
            against.append(f"{joint} has a gap that no known effect explains")
        elif standing_of(axis) == "open":
            untold.append(joint)
    if against:
        return CONTRADICTED, f"but diagnosis {number} contradicts it: {', '.join(against)}"
    asked = [joint for joint in estimate.axes if joint in document.axes and joint not in untold]
    if len(asked) < len(estimate.axes):
        left = [joint for joint in estimate.axes if joint not in asked]
        return OPEN, f"diagnosis {number} does not decide whether an effect is missing in {_list(left)}"
    return CONFIRMED, f"diagnosis {number} finds no effect missing"


def _inertias(joints: Sequence[str]) -> str:
    return f"the inertia of {_list(joints)} is" if len(joints) == 1 else f"the inertias of {_list(joints)} are"


def _list(names: Sequence[str]) -> str:
    return " and ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"
