"""The robot of the reports."""

from pathlib import Path

import pytest

from service.model import Robot
from service.model.configuration import read_robot


@pytest.fixture(scope="session")
def max100(root: Path) -> Robot:
    return read_robot(root / "config" / "robots" / "max100-class.yaml")
