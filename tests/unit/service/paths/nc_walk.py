"""Walks a Sinumerik part program as far as ours go: jumps, conditions, stops, positioning and path blocks."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

CONDITION = re.compile(r"IF (.+?)([<>])([\d.]+) GOTOF (\w+)")
POSITIONING = re.compile(r"POS\[(\w+)\]=(-?[\d.]+) FA\[\w+\]=([\d.]+)")
BLOCK = re.compile(r"(\w+)=(-?\d+\.\d+)")
SETTINGS = re.compile(
    r"TRAFOOF|G40 G90 G94 G500 G710 D0|TRANS|STOPRE|G4 F1|FGROUP\(\w*\)|BRISK|COMPOF|FNORM|G1 G64 G93 F[\d.]+|MSG\(.*\)"
)


@dataclass
class Walk:
    """What a machine did under a program: its stops, and its moves with the number of stops before each."""

    place: dict[str, float]
    stops: int = 0
    moves: list[tuple[str, float, int]] = field(default_factory=list)  # axis, target, stops before
    path: list[float] = field(default_factory=list)
    feed: float | None = None
    message: str = ""
    ended: bool = False


def walk(
    program: str,
    place: Mapping[str, float],
    data: Mapping[str, float],
    at_stop: Callable[[Walk], None] = lambda walk: None,
    work_offset: Mapping[str, float] | None = None,
) -> Walk:
    """Run the program from `place`; `at_stop` is what a person does at an M0 before NC Start."""
    assert max(map(len, program.splitlines())) < 512
    lines = [line.split(";")[0].strip() for line in program.splitlines()]
    labels = {line[:-1]: k for k, line in enumerate(lines) if line.endswith(":")}
    machine = Walk(dict(place))
    offset = work_offset or {}

    def value(expression: str) -> float:
        text = re.sub(r"\$AA_IM\[(\w+)\]", lambda m: repr(machine.place[m[1]]), expression)
        text = re.sub(r"\$AA_IW\[(\w+)\]", lambda m: repr(machine.place[m[1]] + offset.get(m[1], 0.0)), text)
        text = re.sub(r"\$MN_(\w+)", lambda m: repr(data[m[1]]), text)
        return float(eval(text.replace("ABS", "abs"), {"abs": abs}))

    k = 0
    while not machine.ended:
        line = lines[k]
        k += 1
        if condition := CONDITION.fullmatch(line):
            left, right = value(condition[1]), float(condition[3])
            if left > right if condition[2] == ">" else left < right:
                assert labels[condition[4]] > k
                k = labels[condition[4]]
        elif line.startswith("GOTOF "):
            k = labels[line.removeprefix("GOTOF ")]
        elif line == "M0":
            machine.stops += 1
            at_stop(machine)
        elif line == "M30":
            machine.ended = True
        elif move := POSITIONING.fullmatch(line):
            machine.place[move[1]] = float(move[2])
            machine.moves.append((move[1], float(move[2]), machine.stops))
        elif block := BLOCK.fullmatch(line):
            assert machine.feed is not None
            machine.place[block[1]] = float(block[2])
            machine.path.append(float(block[2]))
            machine.moves.append((block[1], float(block[2]), machine.stops))
        elif line and not line.endswith(":"):
            assert SETTINGS.fullmatch(line), line
            if line.startswith("G1 "):
                machine.feed = float(line.rpartition("F")[2])
            if line.startswith("MSG("):
                machine.message = line[5:-2]
                assert len(machine.message) <= 124
    return machine
