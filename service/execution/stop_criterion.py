"""Has a campaign reached the confidence that its plan wants?"""

from collections.abc import Collection

from service.results.estimate import Estimate


def confidence_reached(estimate: Estimate, joints: Collection[str], parameters: int, wanted: float) -> str:
    """Why the campaign may end, or "" while it may not.

    `estimate`: its latest revision; `joints` that the campaign measures; `parameters`: how many base parameters its
    plan is about; `wanted`: largest standard deviation of J over the workspace, percent. What the data leave open has
    no confidence and is never enough. Nor is an estimate of fewer parameters: it takes the joints that have not moved
    yet for locked, and knows the workspace of the others alone.
    """
    if len(estimate.base_parameters) < parameters:
        return ""
    percent = [estimate.axes[joint].confidence_percent for joint in joints if joint in estimate.axes]
    reached = [one for one in percent if one is not None]
    if len(reached) < len(joints) or max(reached) > wanted:
        return ""
    return f"confidence of {wanted:.4g} % reached: J is known to {max(reached):.3g} % over the workspace"
