"""Has a campaign reached the confidence that its plan wants?"""

from collections.abc import Collection, Mapping
from typing import Any


def confidence_reached(estimate: Mapping[str, Any], joints: Collection[str], parameters: int, wanted: float) -> str:
    """Why the campaign may end, or "" while it may not.

    `estimate`: document of its latest revision; `joints` that the campaign measures; `parameters`: how many base
    parameters its plan is about; `wanted`: largest standard deviation of J over the workspace, percent. What the data
    leave open has no confidence and is never enough. Nor is an estimate of fewer parameters: it takes the joints that
    have not moved yet for locked, and knows the workspace of the others alone.
    """
    if len(estimate["base_parameters"]) < parameters:
        return ""
    axes: Mapping[str, Any] = estimate["axes"]
    reached = [axes[joint]["confidence_percent"] for joint in joints if joint in axes]
    if len(reached) < len(joints) or None in reached or max(reached) > wanted:
        return ""
    return f"confidence of {wanted:.4g} % reached: J is known to {max(reached):.3g} % over the workspace"
