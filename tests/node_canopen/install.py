"""Installs the npm packages of the drives into the virtual environment: python -m tests.node_canopen.install"""

from pathlib import Path

from tests.npm import NODE, installed

FOLDER = Path(__file__).resolve().parent


def node_command() -> list[str]:
    """The command that starts the machine. Raises InstallError without its packages."""
    return ["env", f"NODE_PATH={install()}", str(NODE), str(FOLDER / "main.js")]


def install() -> Path:
    """Do nothing if the packages of the lock are installed. Raises InstallError if npm fails."""
    return installed(FOLDER, (".npmrc", "crc"))


if __name__ == "__main__":
    install()
