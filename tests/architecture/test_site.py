"""The documents build as a site without a warning, every page is in it, and it loads nothing from elsewhere."""

import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from tests.constants_page import in_code

pytestmark = pytest.mark.slow

CPU = 60.0  # s, at most, of one build
LOADS = re.compile(r'<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)="(?:https?:)?//', re.IGNORECASE)


def test_the_site_builds(root: Path, tmp_path: Path) -> None:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "sphinx", "-q", "-n", "-W", "--keep-going", root / "docs", tmp_path / "site"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert (done.returncode, done.stderr) == (0, "")
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < CPU
    pages = {path.relative_to(tmp_path / "site") for path in (tmp_path / "site").rglob("*.html")}
    documents = [path.relative_to(root / "docs") for path in (root / "docs").rglob("*.md")]
    assert [path for path in documents if "_build" not in path.parts and path.with_suffix(".html") not in pages] == []
    assert [str(path) for path in pages if LOADS.search((tmp_path / "site" / path).read_text("utf-8"))] == []
    for page, anchor in (
        ("http-api", "post-api-v1-stop-reset"),
        ("http-api", "campaignview"),
        ("options", "sweepid-people-add-key"),
        ("client", "service.web.client.ServiceClient.stop"),
        ("python", "sweepid.identify"),
        ("drive-port", "drivers.ports.DrivePort.halt"),
    ):
        assert f'id="{anchor}"' in (tmp_path / "site" / "reference" / f"{page}.html").read_text("utf-8")
    constants = (tmp_path / "site" / "reference" / "constants.html").read_text("utf-8")
    names = {key.partition(".")[2].partition(",")[0] for key in in_code()}
    assert {name for name in names if f">{name}" not in constants} == set()
