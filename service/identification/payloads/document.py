"""A payload as the document that `sweepid estimate payload --json` writes."""

import numpy as np

from service.identification.model.physical_consistency import Ended
from service.identification.payloads.payload import Payload, body_of
from service.model.results.identified import payload as results
from service.model.robot import INERTIAL_NAMES, Robot

CENTER = ("x", "y", "z")
TENSOR = INERTIAL_NAMES[4:]


def payload_document(robot: Robot, found: Payload) -> results.Payload:
    """SI, in the frame of the last joint; `inertia` about the centre of mass. Parameters that were not excited are
    None.
    """
    figures = tuple(
        results.Figure(
            value=float(value) if excited else None,
            std=float(std) if excited else None,
            std_total=float(total) if excited else None,
            excited=bool(excited),
        )
        for value, std, total, excited in zip(
            found.body, found.body_std, found.body_std_total, found.excited, strict=True
        )
    )
    mass, x, y, z, *tensor = body_of(found.nearest).tolist()
    return results.Payload(
        link=robot.chain.joints[-1].link,
        frame=robot.joints[-1],
        mass=figures[0],
        center=dict(zip(CENTER, figures[1:4], strict=True)),
        inertia=dict(zip(TENSOR, figures[4:], strict=True)),
        parameters=results.Parameters(
            names=tuple(INERTIAL_NAMES),
            values=tuple(found.parameters.tolist()),
            covariance=tuple(map(tuple, found.covariance.tolist())),
            covariance_total=tuple(map(tuple, found.covariance_total.tolist())),
        ),
        physical=results.Physical(
            consistent=found.physical,
            deviation_in_std=found.deviation,
            nearest=results.Body(mass=mass, center=(x, y, z), inertia=dict(zip(TENSOR, tensor, strict=True))),
        ),
        evidence=tuple(results.Evidence(axis=each.joint, source=each.source) for each in found.evidence),
        sentences=tuple(sentences(found)),
    )


def sentences(found: Payload) -> list[str]:
    """Notes for the user in addition to the values."""
    notes: list[str] = []
    if not abs(found.parameters[0]) > 3 * np.sqrt(found.covariance[0, 0]) and found.excited[0]:
        notes.append(f"No mass detected: {found.body[0]:.3g} kg, standard deviation {found.body_std[0]:.2g} kg.")
    if found.parameters[0] < -3 * np.sqrt(found.covariance[0, 0]):
        notes.append("The mass is negative: exchange the bundles before and after, or check the signs of the efforts.")
    missing = [name for name, seen in zip(("mass", *CENTER, *TENSOR), found.excited, strict=True) if not seen]
    if missing:
        notes.append(f"The motions do not excite {', '.join(missing)}: these remain unknown.")
    if not found.physical:
        away = f"{found.deviation:.1f} standard deviations away"
        notes.append(f"These ten parameters are not physical; the nearest physical body is {away}.")
    if found.ended is Ended.UNFINISHED:
        notes.append("The search of the nearest physical body did not converge: do not use it; check mass and motions.")
    return notes
