"""How soon the command line answers: processor time and memory of a process, beside one that asks typer alone."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from docs.benchmarks.measured import Measured

SWEEPID = str(Path(sys.executable).with_name("sweepid"))
TYPER = "import typer; app = typer.Typer(); app.command()(lambda name: None); app(['--help'])"
PEER, PEER_COMMAND = "a command of typer alone", (sys.executable, "-c", TYPER)
COMMANDS = {"--help": (0.3, 60.0), "measure --help": (0.3, 60.0), "--version": (0.1, 60.0)}  # s and MB at most
REPEATS = 3
LAUNCHER = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
told = resource.getrusage(resource.RUSAGE_CHILDREN)
print(told.ru_utime, told.ru_stime, told.ru_maxrss)
"""  # a small one: what starts a process counts as memory of it


def used(*command: str) -> tuple[float, float]:
    """s of the processor and MB of resident memory of the process of this command."""
    launched = [sys.executable, "-c", LAUNCHER, *command]
    user, system, kilobytes = subprocess.run(launched, check=True, capture_output=True, text=True).stdout.split()
    return float(user) + float(system), float(kilobytes) / 1e3


def answered(words: str, repeats: int) -> Measured:
    """Best of so many; the first of each side is left out: it fills the caches of the disk."""
    turns = [(used(SWEEPID, *words.split()), used(*PEER_COMMAND)) for _ in range(repeats + 1)][1:]
    (ours, memory), (peer, peer_memory) = (min(side) for side in zip(*turns, strict=True))
    return Measured(
        name=f"sweepid {words}", unit="s", ours=ours, peer=peer, beside=PEER, repeats=repeats,
        note=f"{memory:.0f} MB, the peer {peer_memory:.0f} MB",
    )  # fmt: skip


def run() -> Iterator[Measured]:
    for words, (seconds, memory) in COMMANDS.items():
        told = answered(words, REPEATS)
        met = told.ours <= seconds and float(told.note.partition(" ")[0]) <= memory
        yield replace(told, target=f"<= {seconds:g} s, {memory:g} MB", met=met)


def quick() -> Iterator[Measured]:
    yield answered("--help", 3)
