"""What an estimate is worth, as a table for people."""

from rich.console import Console
from rich.table import Table

from service.benefit import Benefit, ModelBenefit


def print_benefit(found: Benefit, console: Console) -> None:
    """Two lines an axis, what was held out, and what is not judged."""
    table = Table(title="What the estimate is worth, on held-out sweeps")
    for name in ("axis", "model"):
        table.add_column(name)
    for name in ("J off, %", "left at lines", "of it, %", "left in all", "largest", "smallest seen", "force, N"):
        table.add_column(name, justify="right")
    for joint, axis in found.axes.items():
        table.add_row(joint, "CAD", *_figures(axis.cad))
        table.add_row(f"({axis.unit})", "estimate", *_figures(axis.identified), end_section=True)
    console.print(table)
    for joint, axis in found.axes.items():
        held, whole = axis.held_out_poses, axis.poses
        console.print(
            f"{joint}: {len(axis.held_out)} sweeps in {held} of {whole} poses held out (every {found.every}th); "
            f"with the estimate {axis.lines_ratio:.3g} times less is left at the lines, and "
            f"{axis.smallest_ratio:.3g} times less effort is seen.",
            highlight=False,
        )
    for joint, why in found.not_judged.items():
        console.print(f"Not judged: {joint} {why}.", highlight=False)
    console.print(
        f"Smallest seen: outside effort that a torque monitor tells with one false alarm in {found.quiet_hours:g} h; "
        "force: at the end of the robot, where it turns the axis best.",
        style="dim",
        highlight=False,
    )


def _figures(model: ModelBenefit) -> list[str]:
    off = model.inertia_percent
    return [
        f"{off.value:.2f}" if off.std is None else f"{off.value:.2f} ± {off.std:.2f}",
        f"{model.lines_rms:.3g}",
        f"{model.left_percent:.2g}",
        f"{model.effort_rms:.3g}",
        f"{model.effort_peak:.3g}",
        f"{model.smallest_effort:.3g}",
        "–" if model.smallest_force is None else f"{model.smallest_force:.3g}",
    ]
