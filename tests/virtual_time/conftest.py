"""The contract suite here has the same tests as in `tests/contract`."""

import pytest

from tests.contract.bench import leave_out


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    leave_out(config, items)
