"""System programs that tests need, by Debian's packages; `python3 -m tests.programs` prints those that are missing.

A test whose program is missing is skipped with one line that names package and command; where CI is set, a skip fails.
"""

import os
import shutil
import sys
from ctypes.util import find_library
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest

PACKAGES = {  # by program; what stands in more than one package is one program here
    "bash": ("bash",),
    "cc": ("gcc", "libc6-dev"),  # tests/vcan/xstate.c
    "chromium": ("chromium",),
    "curl": ("curl",),
    "docker-compose": ("docker-compose",),  # it checks docker-compose.yml
    "initdb": ("postgresql",),
    "ip": ("iproute2",),
    "linux.uml": ("user-mode-linux",),  # a kernel with CAN, where this one has none
    "mosquitto": ("mosquitto",),  # an MQTT broker
    "mosquitto_sub": ("mosquitto-clients",),
    "openssl": ("openssl",),
    "pango": ("libpango-1.0-0", "libpangoft2-1.0-0", "libharfbuzz-subset0", "fonts-dejavu-core"),  # reports as PDF
    "prometheus": ("prometheus",),
    "promtool": ("prometheus",),
    "setpriv": ("util-linux",),  # PostgreSQL refuses to run as root
}
OTHER_NAMES = {"chromium": ("chromium-browser", "google-chrome")}


def path_of(program: str) -> Path | None:
    """Where a program (a library, of Pango) is."""
    if program == "pango":
        fonts = next(Path("/usr/share/fonts").glob("truetype/*/*.ttf"), None)
        return fonts if find_library("pangoft2-1.0") else None
    if program == "initdb" and (versions := list(Path("/usr/lib/postgresql").glob("*/bin/initdb"))):
        return max(versions, key=lambda path: int(path.parts[-3]))
    names = (program, *OTHER_NAMES.get(program, ()))
    search = f"{os.environ.get('PATH', os.defpath)}{os.pathsep}/usr/sbin"
    found = next(filter(None, (shutil.which(name, path=search) for name in names)), None)
    return Path(found) if found else None


def reason(*programs: str) -> str:
    """Why a test that needs these is skipped; "" if it is not."""
    absent = [program for program in programs if path_of(program) is None]
    packages = dict.fromkeys(package for program in absent for package in PACKAGES[program])
    return f"no {', '.join(absent)}: apt-get install {' '.join(packages)}" if absent else ""


def needs(*programs: str) -> "pytest.MarkDecorator":
    """Skips a test where one of these is missing."""
    import pytest

    why = reason(*programs)
    return pytest.mark.skipif(bool(why), reason=why or "not missing")


def require(*programs: str) -> None:
    """The same for a fixture."""
    import pytest

    if why := reason(*programs):
        pytest.skip(why)


if __name__ == "__main__":
    missing = [packages for program, packages in PACKAGES.items() if path_of(program) is None]
    sys.stdout.write(" ".join(dict.fromkeys(package for packages in missing for package in packages)))
