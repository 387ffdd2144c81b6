"""Completions of the shell: the script (`sweepid --completions bash`), and the words that a shell asks for.

The script and the protocol are Typer's. A shell asks with the environment: `VARIABLE` says for which shell, and the
line so far is in `COMP_WORDS` (bash) or `_TYPER_COMPLETE_ARGS` (zsh, fish).
"""

import os
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


def asked() -> list[str] | None:
    """The whole words after the name of the program in the line that a shell wants to complete; None: none asks."""
    if VARIABLE not in os.environ:
        return None
    completion_init()
    line = os.environ.get("COMP_WORDS", os.environ.get("_TYPER_COMPLETE_ARGS", ""))
    words = line.split()[1:]
    if line and not line[-1].isspace() and "COMP_CWORD" not in os.environ:
        return words[:-1]
    return words[: max(int(os.environ.get("COMP_CWORD", len(words) + 1)) - 1, 0)]
