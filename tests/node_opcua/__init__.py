"""An OPC UA client that is not ours and shares no code with the server: node-opcua, from the npm registry."""

import fcntl
import json
import os
import subprocess
from pathlib import Path
from typing import Any

from tests.programs import require

PACKAGE = "node-opcua-client@2.186.4"
_HERE = Path(__file__).parent
_PATIENCE = 300.0  # s


class NodeClient:
    """Each order is a process of its own."""

    def __init__(self, modules: Path) -> None:
        self._modules = modules

    def start(self, **order: object) -> subprocess.Popen[str]:
        return subprocess.Popen(
            ["node", str(_HERE / "client.cjs"), json.dumps(order)],
            env=os.environ | {"NODE_PATH": str(self._modules)},
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
    """Installed once, beside the caches of others."""
    require("node", "npm")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sweepid" / PACKAGE.replace("@", "-")
    cache.mkdir(parents=True, exist_ok=True)
    with (cache / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # other processes of this run
        if not (cache / "complete").exists():
            command = ["npm", "install", "--prefix", str(cache), "--no-audit", "--no-fund", "--ignore-scripts", PACKAGE]
            subprocess.run(command, check=True, capture_output=True, timeout=_PATIENCE)
            (cache / "complete").touch()
    return NodeClient(cache / "node_modules")
