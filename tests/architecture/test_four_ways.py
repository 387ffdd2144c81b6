"""`docs/explanation/four-ways.md` is true: its files are there, with the names it tells, twelve a way at most."""

import re
from pathlib import Path

MOST = 12


def ways(root: Path) -> dict[str, list[tuple[str, list[str]]]]:
    """File and names of each step, by the heading of the way."""
    text = (root / "docs" / "explanation" / "four-ways.md").read_text()
    _, *sections = re.split(r"^## ", text, flags=re.MULTILINE)
    found: dict[str, list[tuple[str, list[str]]]] = {}
    for section in sections:
        heading, _, body = section.partition("\n")
        steps = re.findall(r"^\d+\. `([^`]+)`: (.*)$", body, re.MULTILINE)
        found[heading] = [(file, re.findall(r"`(\w+)`", said)) for file, said in steps]
    return found


def test_each_step_is_there(root: Path) -> None:
    found = ways(root)
    assert [heading.partition(":")[0] for heading in found] == ["A sweep", "A sample", "A stop", "A hidden effect"]
    for heading, steps in found.items():
        assert 2 < len(steps) <= MOST, heading
        for file, names in steps:
            assert names, f"{file}: which name in it?"
            source = (root / file).read_text()
            for name in names:
                assert re.search(rf"^\s*(async def|def|class) {name}\b|^{name}\b", source, re.MULTILINE), (file, name)
