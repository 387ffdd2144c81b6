"""Completions of the shell (`sweepid --completions bash`). Script and protocol are Typer's."""

from typing import Literal

# Typer has no other place from which a program may take them
from typer.completion import (
    completion_init,  # pyright: ignore[reportPrivateImportUsage]
    get_completion_script,  # pyright: ignore[reportPrivateImportUsage]
)

Shell = Literal["bash", "zsh", "fish"]
VARIABLE = "_SWEEPID_COMPLETE"


def script(shell: Shell) -> str:
    """What the shell is to load."""
    return get_completion_script(prog_name="sweepid", complete_var=VARIABLE, shell=shell)


def prepare() -> None:
    """Let Typer answer the shell that asks."""
    completion_init()
