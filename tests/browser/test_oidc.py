"""The button of the identity provider, there and back again in a real browser."""

from pathlib import Path

from playwright.sync_api import expect

from tests.browser.browsing import browsing
from tests.programs import needs
from tests.unit.service.api.conftest import profile, serving  # noqa: F401 - no machine
from tests.unit.service.people.test_oidc import issuer, provider_settings  # noqa: F401 - the provider

pytestmark = needs("chromium")


def test_the_button_leads_to_the_provider_and_back(tmp_path: Path, profile: Path, issuer: str) -> None:  # noqa: F811
    settings = provider_settings(issuer, tmp_path)
    with serving(tmp_path, profile, login=True, oidc=settings) as url, browsing(url) as page:
        button = page.get_by_role("button", name="Log in with the company's account")
        button.click()
        page.get_by_role("button", name="nobody", exact=True).click()
        expect(page.locator("#login-why")).to_contain_text("no group of nobody")
        assert page.url == f"{url}/"  # the code stays in nobody's history
        button.click()
        page.get_by_role("button", name="olga", exact=True).click()
        expect(page.locator("#me-who")).to_have_text("olga, operator")
        assert page.url == f"{url}/"
