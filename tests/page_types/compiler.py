"""The TypeScript compiler on the scripts of the pages, as they are or with something planted."""

import json
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from service.web.hmi.pages import texts
from tests.npm import NODE, installed
from tests.page_types.declarations import declarations, read

FOLDER = Path(__file__).resolve().parent
TIMEOUT = 300.0  # s; 3 s on an idle computer


@dataclass(frozen=True)
class Wrong:
    """One thing that the compiler finds in a script."""

    file: str
    line: int
    text: str


def check(scripts: Mapping[str, str], folder: Path) -> list[Wrong]:
    """What is wrong in the scripts (text by name), written into `folder` together with the types."""
    for name, text in scripts.items():
        (folder / name).write_text(text, "utf-8")
    (folder / "openapi.d.ts").write_text(declarations(read()), "utf-8")
    keys = " | ".join(json.dumps(language) for language in texts())
    (folder / "texts.d.ts").write_text(f"export const TEXTS: Record<{keys}, Record<string, string>>;\n", "utf-8")
    shutil.copy(FOLDER / "answers.d.ts", folder)
    shutil.copy(FOLDER / "check.mjs", folder)
    (folder / "node_modules").symlink_to(installed(FOLDER))
    command = [str(NODE), "check.mjs", "."]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT, check=True)
    return [Wrong(**json.loads(line)) for line in run.stdout.splitlines()]
