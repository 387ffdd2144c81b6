"""What axe-core finds on a page against WCAG 2.2, levels A and AA."""

from importlib.resources import files
from typing import cast

from playwright.sync_api import Page

from tests.browser.looking import settled

_AXE = files("axe_playwright_python").joinpath("axe.min.js").read_text("utf-8")
_TAGS = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa")
_FINDINGS = """async (tags) => {
  const { violations, passes } = await axe.run(document, { runOnly: tags });
  if (!passes.length) return ["axe looked at nothing"];
  return violations.flatMap(({ id, nodes }) => nodes.map((one) => `${id}: ${one.target} ${one.failureSummary}`));
}"""


def findings(page: Page) -> list[str]:
    """One line a rule and place that breaks it."""
    if not page.evaluate("'axe' in window"):
        page.evaluate(_AXE)
    return cast("list[str]", page.evaluate(_FINDINGS, list(_TAGS)))


def both_schemes(page: Page) -> list[str]:
    """The findings in light and in dark."""
    found: list[str] = []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        settled(page)
        found += [f"{scheme}: {one}" for one in findings(page)]
    return found
