"""Prints the joint estimate of sweeps and trajectories."""

from typing import Any

from rich.console import Console
from rich.table import Table


def print_combination(combination: dict[str, Any], console: Console) -> None:
    """Every base parameter of the whole dynamics, what determines it, or why nothing does."""
    table = Table(title=f"Sweeps and {len(combination['trajectories'])} trajectories together, SI")
    for name in ("parameter", "value", "std", "std by sweeps", "by trajectories", "of the model", "determined by"):
        table.add_column(name, overflow="fold", justify="left" if name in ("parameter", "determined by") else "right")
    became = set(combination["became_identifiable"])
    for parameter in combination["base_parameters"]:
        stds = (parameter[f"std{source}"] for source in ("", "_sweeps", "_trajectories", "_nominal"))
        determined = parameter["source"] + (", only now" if parameter["name"] in became else "")
        table.add_row(
            parameter["name"],
            f"{parameter['value']:.5g}",
            *("-" if std is None else f"{std:.3g}" for std in stds),
            parameter["reason"] or determined,
        )
    console.print(table)
    identified = sum(parameter["identified"] for parameter in combination["base_parameters"])
    console.print(f"{identified} of {len(combination['base_parameters'])} base parameters identified")
