"""An option of one test; see there."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--write-fault-table", action="store_true", help="write docs/reference/faults.md anew")
