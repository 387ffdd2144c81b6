"""What a guide has its reader do: files, each a block after a line that begins with its name, or the file itself that
the block includes, and commands."""

import re
from pathlib import Path

HOW_TO = Path(__file__).resolve().parents[1] / "docs" / "how-to"
INCLUDED = re.compile(r"^```\{literalinclude\} (\S+)\n```$", re.MULTILINE)
FILE = re.compile(r"^`([\w./-]+)`[^\n]*:\n\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMANDS = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
MOST = 4  # files that a reader can be asked to write


def written(guide: str, folder: Path) -> list[str]:
    """Writes the files of a guide into a folder; gives its commands, a line each."""
    text = INCLUDED.sub(lambda found: f"```text\n{(HOW_TO / found[1]).read_text()}```", (HOW_TO / guide).read_text())
    files = FILE.findall(text)
    assert 0 < len(files) <= MOST
    folder.mkdir(parents=True)
    for name, content in files:
        (folder / name).write_text(content)
    return [line for block in COMMANDS.findall(text) for line in block.splitlines()]
