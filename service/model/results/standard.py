"""Standard parameters of links and motors that give the base parameters of an estimate."""

from typing import Annotated

from pydantic import Field

from service.model.results.part import Part

LARGEST = 1e15  # of a value in SI, as in a URDF: above any robot; its square does not overflow
Bounded = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]


class StandardParameters(Part):
    """One physical robot with these base parameters: ten numbers per link, and the motors' inertias, by name."""

    links: dict[str, dict[str, Bounded]]
    motor_inertias: dict[str, Bounded]


class Physical(Part):
    """Change of the base parameters to be physically consistent, standard deviations; `warning` if the search for the
    nearest robot did not converge."""

    deviation_in_std: float | None
    warning: str = ""
