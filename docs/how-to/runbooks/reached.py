"""How well J is known after a campaign, and whether that is the required confidence."""

from collections.abc import Sequence

from runbook import Exit, Runbook

from service.web.client import Json

LEFT_OPEN = (
    "J is left open: the sweeps determine a base parameter no better than CAD does; measure more poses, and see that "
    "the robot file has the cogging orders of the motors"
)


def confidence(book: Runbook, campaign: Json, joints: Sequence[str], wanted: float) -> Exit:
    """Print for a completed campaign how well J of the `joints` is known, and whether it ended at `wanted`, %."""
    axes = book.client.estimate(campaign["id"])["document"]["axes"]
    reached = {joint: axes[joint]["confidence_percent"] if joint in axes else None for joint in joints}
    for joint, percent in reached.items():
        told = LEFT_OPEN if percent is None else f"J known to {percent:.3g} %"
        book.step(joint, told, percent=percent)
    if all(percent is not None and percent <= wanted for percent in reached.values()):
        book.step("ended by", f"confidence of {wanted:g} % reached", cause=campaign["cause"])
        return Exit.DONE
    book.step("ended by", f"sweeps used up, {wanted:g} % not reached", cause=campaign["cause"])
    return Exit.AMBER
