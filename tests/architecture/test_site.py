"""The documents build as a site without a warning, every page is in it, and it loads nothing from elsewhere."""

import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

CPU = 60.0  # s, at most, of one build
LOADS = re.compile(r'<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)="(?:https?:)?//', re.IGNORECASE)


def build(source: Path, to: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "sphinx", "-q", "-n", "-W", "--keep-going", str(source), str(to)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def test_the_site_builds(root: Path, tmp_path: Path) -> None:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = build(root / "docs", tmp_path / "site")
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
        ("client", "service.client.ServiceClient.stop"),
        ("drive-port", "drivers.ports.DrivePort.halt"),
    ):
        assert f'id="{anchor}"' in (tmp_path / "site" / "reference" / f"{page}.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[there](#nowhere)", "nowhere"),
        ("[there](nowhere.md)", "nowhere.md"),
        ("[there](index.md#nowhere)", "nowhere"),
    ],
)
def test_a_link_to_nowhere_fails_the_build(text: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "conf.py").write_text('extensions = ["myst_parser"]\nmyst_heading_anchors = 4\n')
    (tmp_path / "index.md").write_text(f"# A page\n\n{text}\n")
    done = build(tmp_path, tmp_path / "_build")
    assert done.returncode == 1
    assert told in done.stderr
