"""The short form of the workers' soak: 1,500 jobs. The long run is by hand."""

import os
import shutil
from pathlib import Path

import pytest

from tests.soak.workers import MOST_GROWTH, WARM, soak

TASKS = WARM + 1000


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("openssl") is None and "CI" not in os.environ,
    reason="no openssl here to make a certificate; CI has one",
)
async def test_no_process_grows_with_the_jobs_that_it_has_done(tmp_path: Path) -> None:
    found = await soak(tmp_path, TASKS)
    assert {name: grown for name, grown in found["growth_mib"].items() if grown > MOST_GROWTH} == {}
