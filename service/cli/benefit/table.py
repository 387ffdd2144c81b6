"""What an estimate is worth, as a table for people."""

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from service.report.benefit import Benefit, ModelBenefit

SAME = 0.03  # relative: values that differ by less are called the same


def print_benefit(found: Benefit, console: Console) -> None:
    """Two lines an axis, what was held out, and what is not judged."""
    table = Table(title="What the estimate is worth, on held-out sweeps", box=SIMPLE_HEAD, padding=0)
    for name in ("axis", "model"):
        table.add_column(name, overflow="fold")
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
            f"left at the lines: {_compared(axis.lines_ratio)}; smallest seen: {_compared(axis.smallest_ratio)}.",
            highlight=False,
        )
    for joint, why in found.not_judged.items():
        console.print(f"Not judged: {joint} {why}.", highlight=False)
    console.print(
        "Smallest seen: the smallest external effort that a torque monitor detects with one false alarm in "
        f"{found.quiet_hours:g} h; force: the same at the end of the robot, perpendicular to the lever arm.",
        style="dim",
        highlight=False,
    )


def _compared(ratio: float) -> str:
    """What a value of CAD over that of the estimate means."""
    if abs(ratio - 1) < SAME:
        return "the same with CAD and estimate"
    return f"{max(ratio, 1 / ratio):.3g} times {'smaller' if ratio > 1 else 'larger'} with the estimate than with CAD"


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
