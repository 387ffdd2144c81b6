"""Prints the joint estimate of sweeps, trajectories and free motions."""

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from service.results.combination import Combination, FreeMotionAxis


def print_combination(combination: Combination, console: Console) -> None:
    """Every base parameter of the whole dynamics, what determines it, or why nothing does."""
    runs, motions = len(combination.trajectories), len(combination.free_motions)
    table = Table(title=f"Sweeps, {runs} trajectories and {motions} free motions together, SI")
    for name in ("parameter", "value", "std", "std by sweeps", "by trajectories", "of the model", "determined by"):
        table.add_column(name, overflow="fold", justify="left" if name in ("parameter", "determined by") else "right")
    became = set(combination.became_identifiable)
    for parameter in combination.base_parameters:
        stds = (parameter.std, parameter.std_sweeps, parameter.std_trajectories, parameter.std_nominal)
        determined = parameter.source + (", only now" if parameter.name in became else "")
        table.add_row(
            parameter.name,
            f"{parameter.value:.5g}",
            *("-" if std is None else f"{std:.3g}" for std in stds),
            parameter.reason or determined,
        )
    console.print(table)
    identified = sum(parameter.identified for parameter in combination.base_parameters)
    console.print(f"{identified} of {len(combination.base_parameters)} base parameters identified")
    _print_held_out(combination.free_motion_axes, console)


def _print_held_out(axes: Mapping[str, FreeMotionAxis], console: Console) -> None:
    """How well efforts of free motions are predicted along parts that the fit has not seen."""
    if not axes:
        return
    table = Table(title="Free motions, effort below the band's end, RMS, SI")
    for name in ("axis", "left by the fit", "held out", "% of rated", "noise floor"):
        table.add_column(name, justify="left" if name == "axis" else "right")
    for joint, axis in axes.items():
        sizes = (axis.residual_rms, axis.held_out_rms, axis.held_out_percent, axis.noise_floor_rms)
        table.add_row(joint, *("-" if size is None else f"{size:.3g}" for size in sizes))
    console.print(table)
