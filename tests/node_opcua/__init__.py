"""An OPC UA client that is not ours and shares no code with the server: node-opcua, from the npm registry."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

from tests.npm import NODE, installed

_HERE = Path(__file__).resolve().parent
_PATIENCE = 300.0  # s


class NodeClient:
    """Each order is a process of its own."""

    def __init__(self, modules: Path) -> None:
        self._environment = os.environ | {"NODE_PATH": str(modules)}

    def start(self, **order: object) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [NODE, _HERE / "client.cjs", json.dumps(order)],
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def ask(self, **order: object) -> dict[str, Any]:
        """What it found; `error` where it could not."""
        return self.answer(self.start(**order))

    def answer(self, process: subprocess.Popen[str]) -> dict[str, Any]:
        said, complained = process.communicate(timeout=_PATIENCE)
        assert said, complained
        return json.loads(said.splitlines()[-1])


def node_client() -> NodeClient:
    """With its packages installed, once for each environment."""
    return NodeClient(installed(_HERE, (".npmrc",)))
