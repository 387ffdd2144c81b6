"""The equations of one axis are only valid if all others stand still: sweeps with several moving axes are rejected."""

from collections.abc import Sequence
from itertools import combinations

from service.identification.spectra.frequency_response import Spectrum
from service.model.errors import BadInput


def check_moved_alone(spectra: Sequence[Spectrum]) -> None:
    """BadInput with the sweep if a trajectory ran together with another axis.

    Together are trajectories of several axes that began in the same pose and overlap in time, and those whose block
    states several axes.
    """
    trajectories = [each for each in spectra if each.spec.excitation == "trajectory"]
    for each in trajectories:
        if each.spec.axes_at_once > 1:
            raise BadInput(
                f"sweep {each.spec.id}",
                f"its block {each.spec.block!r} moved several axes at once: the equations of {each.spec.axis} alone do "
                "not hold for it; identify it with the sweeps of the other axes as one trajectory",
            )
    for first, second in combinations(trajectories, 2):
        if _together(first, second):
            raise BadInput(
                f"sweep {second.spec.id}",
                f"{second.spec.axis} moved while {first.spec.axis} did in sweep {first.spec.id} (same pose, "
                f"started_at {second.spec.started_at:g} and {first.spec.started_at:g} s): the equations of one axis do "
                "not hold; identify them as one trajectory of several axes, or correct started_at if they ran one "
                "after the other",
            )


def _together(first: Spectrum, second: Spectrum) -> bool:
    one, other = first.spec, second.spec
    if one.axis == other.axis or one.pose != other.pose:
        return False
    return one.started_at < _end(second) and other.started_at < _end(first)


def _end(spectrum: Spectrum) -> float:
    """End of the record, s on the campaign's clock."""
    return spectrum.spec.started_at + spectrum.spec.measure_from + spectrum.samples / spectrum.spec.sample_rate
