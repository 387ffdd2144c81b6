"""With `login: true` the pages ask for a password or a key, let each do what the role may; STOP is free."""

import shutil
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest
from playwright.sync_api import Page, Response, expect

from service.store.access import Role
from service.store.database import open_database
from service.store.people.users import KeyStore, UserStore
from service.web.client import ServiceClient
from tests.browser.browsing import browsing
from tests.browser.looking import faint, small
from tests.browser.scripted import Json, campaign, scripted
from tests.programs import needs
from tests.system.rest_bench import Service, add_plan, serving, until, virtual_machine
from tests.unit.service.api.conftest import bundle, profile, robot, serving as serving_alone  # noqa: F401 - three sweeps, and no machine
from tests.unit.service.people.conftest import certificate

pytestmark = needs("chromium")
KEY = f"sweepid-{'0' * 64}"


@pytest.fixture
def service(tmp_path: Path, profile: Path) -> Iterator[Service]:  # noqa: F811
    """No machine answers it."""
    with serving(tmp_path, profile, login=True) as service:
        yield service


@pytest.fixture
def page(service: Service) -> Iterator[Page]:
    with browsing(service.url) as page:
        yield page


def keys_of(service: Service) -> dict[str, str]:
    """By role, of people who are called as it."""
    with open_database(f"sqlite:///{service.data / 'sweepid.sqlite'}") as database:
        store, day, who = KeyStore(database), timedelta(days=1), {"actor": "test"}
        return {role.word: store.add(f"the-{role.word}", role, day, who)[1] for role in Role}


def log_in(page: Page, key: str) -> None:
    page.get_by_label("Your key").fill(key)
    page.get_by_role("button", name="Log in").click()


def test_a_page_that_nobody_is_logged_in_to_stops_the_machine(tmp_path: Path) -> None:
    with (
        virtual_machine(tmp_path, speed_factor=1.0) as machine,
        serving(tmp_path, machine.profile, login=True) as service,
        ServiceClient(service.url, keys_of(service)["engineer"]) as engineer,
        browsing(service.url) as page,
    ):
        expect(page.locator("#login")).to_be_visible()
        expect(page.locator("#machine")).to_have_text("nobody is logged in")
        expect(page.locator("#stated")).to_have_text("all axes stand without energy")
        expect(page.locator("main")).to_be_hidden()
        assert (faint(page), small(page)) == ([], [])
        engineer.start(int(engineer.add_campaign(add_plan(engineer, axes=["joint_1"], poses=2))["id"]))
        until(lambda: not machine.stands(), "an axis with energy")
        page.get_by_role("button", name="STOP").click()
        until(machine.stands, "standing axes")
        until(engineer.stops, "a latched stop")
        assert [stop["by"] for stop in engineer.stops()] == ["operator page"]


def test_the_page_is_what_the_role_is() -> None:
    planned = campaign(state="planned")
    refused = {"POST /campaigns/{campaign_id}/start": "operator", "POST /diagnoses": "engineer"}
    with scripted(answers={"campaigns": {"items": [planned], "next": None}, "campaigns/1": planned}) as service:
        service.known = {KEY}
        service.answers["me"] = {"login": True, "name": "Eva", "role": "viewer", "session": False, "refused": refused}
        with browsing(service.url) as page:
            expect(page.locator("#login")).to_be_visible()
            expect(page.locator("#login-why")).to_have_text("")  # who has not tried yet did nothing wrong
            log_in(page, KEY[:-1] + "1")
            expect(page.locator("#login-why")).to_contain_text("not authenticated: ")
            log_in(page, KEY)
            expect(page.locator("#me-who")).to_have_text("Eva, viewer")
            expect(page.locator("#login")).to_be_hidden()
            expect(page.locator("#start")).to_be_disabled()
            expect(page.locator("#why-start")).to_have_text("needs operator, you are viewer")
            assert (faint(page), small(page)) == ([], [])
            page.get_by_role("link", name="Diagnosis").click()  # the tab keeps the key
            expect(page.locator("#me-who")).to_have_text("Eva, viewer")
            diagnose = page.get_by_role("button", name="Diagnose")
            expect(diagnose).to_be_disabled()
            expect(page.locator("#new .needs")).to_have_text("needs engineer, you are viewer")
            page.get_by_role("button", name="Log out").click()
            expect(page.locator("#login")).to_be_visible()
            service.answers["me"] |= {"role": "engineer", "refused": {}}
            log_in(page, KEY)
            expect(diagnose).to_be_enabled()
            page.get_by_role("link", name="Campaigns").click()
            expect(page.locator("#start")).to_be_enabled()
            with page.expect_popup() as other:  # another tab asks anew
                page.evaluate("open(location.href, '_blank', 'noopener')")
            expect(other.value.locator("#login")).to_be_visible()


def test_live_samples_come_with_the_key() -> None:
    """A browser sends no header when it opens a socket: the key is named as a subprotocol."""
    runs = campaign(state="running", motion=[{"kind": "sweep", "axes": ["joint_1"], "target": None, "seconds": 9.0}])
    answers: dict[str, Json] = {"campaigns": {"items": [runs], "next": None}, "campaigns/1": runs}
    with scripted(answers=answers) as service:
        service.known = {KEY}
        with browsing(service.url) as page:
            log_in(page, KEY)
            until(lambda: service.offered == ["sweepid.live", f"sweepid.key.{KEY}"], "the live samples")


def test_events_and_reports_come_with_the_key(
    service: Service,
    page: Page,
    bundle: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    keys = keys_of(service)
    log_in(page, keys["viewer"])
    expect(page.locator("#progress-text")).to_contain_text("no campaign yet")
    archive = shutil.make_archive(str(tmp_path / "three-sweeps"), "zip", bundle)
    with ServiceClient(service.url, keys["engineer"]) as engineer:
        engineer.import_bundle(Path(archive))
    expect(page.locator("#campaign-state")).to_have_text("completed")  # told by the stream of events alone
    with page.expect_download() as saved:
        page.get_by_role("link", name="Report").click()
    assert saved.value.suggested_filename == "campaigns-1-report.html"
    assert "max100-class" in Path(saved.value.path()).read_text("utf-8")


def test_a_person_logs_in_with_a_password_and_out(service: Service, page: Page) -> None:
    name, password = "Anna Blume", "a horse and a battery"
    with open_database(f"sqlite:///{service.data / 'sweepid.sqlite'}") as database:
        UserStore(database).add(name, Role.OPERATOR, password, {"actor": "test"})
    why, who = page.locator("#login-why"), page.locator("#me-who")
    page.get_by_role("button", name="Log in").click()
    expect(why).to_have_text("name and password, or a key")
    for typed, answer in (("not the horse of anna", "name or password is wrong"), (password, None)):
        page.get_by_label("Name", exact=True).fill(name)
        page.get_by_label("Password").fill(typed)
        page.get_by_role("button", name="Log in").click()
        if answer:
            expect(why).to_have_text(answer)
    expect(who).to_have_text(f"{name}, operator")
    expect(page.locator("#login")).to_be_hidden()
    assert page.evaluate("document.cookie") == ""  # no script reads it
    with page.context.expect_page() as other:  # another tab is the same browser
        page.evaluate("open(location.href, '_blank', 'noopener')")
    expect(other.value.locator("#me-who")).to_have_text(f"{name}, operator")
    other.value.close()
    page.get_by_role("button", name="STOP").click()
    expect(page.locator("#held-by")).to_contain_text(f"Stopped by {name} (operator page): stop button")
    with page.expect_response("**/stop/reset") as released:
        page.get_by_role("button", name="Machine checked: release", exact=True).click()
    assert released.value.status == 200
    page.get_by_role("button", name="Log out").click()
    expect(page.locator("#login")).to_be_visible()
    expect(why).to_have_text("")
    page.get_by_role("button", name="STOP").click()  # without anybody
    with ServiceClient(service.url, keys_of(service)["viewer"]) as viewer:
        until(lambda: "operator page" in [stop["by"] for stop in viewer.stops()], "a latched stop of nobody's")
    assert page.context.cookies() == []


@needs("openssl")
def test_by_tls_the_page_stops_by_both_ways(tmp_path: Path, profile: Path) -> None:  # noqa: F811
    pem, key = (str(path) for path in certificate(tmp_path, "cell7"))
    with (
        serving_alone(tmp_path, profile, login=True, tls_certificate=pem, tls_key=key) as url,
        browsing(url, any_certificate=True) as page,
    ):
        expect(page.locator("#login")).to_be_visible()
        with (
            page.expect_response(f"{url}/api/v1/stop?*") as service,
            page.expect_response(of_the_stop_process) as beside,
        ):
            page.get_by_role("button", name="STOP").click()
        assert (service.value.status, beside.value.status) == (503, 503)  # there is no machine


def of_the_stop_process(answer: Response) -> bool:
    return answer.url.startswith("https:") and "/api/" not in answer.url and "/stop?" in answer.url
