"""Stop criterion: whether a campaign has reached the confidence required by its plan."""

from collections.abc import Collection

from service.model.results.estimate import Estimate


def confidence_reached(estimate: Estimate, joints: Collection[str], parameters: int, wanted: float) -> str:
    """Why the campaign may end, or "" while it may not.

    `estimate`: its latest revision; `joints`: measured by the campaign; `parameters`: number of base parameters of
    its plan; `wanted`: largest standard deviation of J over the workspace, percent. An undetermined value never
    fulfils the criterion. Neither does an estimate with fewer parameters: it assumes that joints that have not moved
    yet are locked, and covers only the workspace of the others.
    """
    if len(estimate.base_parameters) < parameters:
        return ""
    percent = [estimate.axes[joint].confidence_percent for joint in joints if joint in estimate.axes]
    reached = [one for one in percent if one is not None]
    if len(reached) < len(joints) or max(reached) > wanted:
        return ""
    return f"confidence of {wanted:.4g} % reached: J is known to {max(reached):.3g} % over the workspace"
