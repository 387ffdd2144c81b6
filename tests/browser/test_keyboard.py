"""With the keyboard alone: from the plan to a sweep, the stop, its release and the end of the campaign."""

from playwright.sync_api import Locator, Page, expect

from service.web.client import ServiceClient
from tests.programs import needs
from tests.system.rest_bench import Service, VirtualMachine, until

pytestmark = needs("chromium")
FAR = 80  # presses of Tab that lead once around a page


def go_to(page: Page, wanted: Locator) -> None:
    """By Tab alone, and visibly."""
    expect(wanted).to_be_visible()
    for _ in range(FAR):
        if wanted.evaluate("one => one === document.activeElement"):
            style = wanted.evaluate("one => [getComputedStyle(one).outlineStyle, one.matches(':focus-visible')]")
            assert style[1], "the focus does not show"
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"{wanted}: not reached by {FAR} presses of Tab")


def press(page: Page, name: str, key: str = "Enter") -> None:
    button = page.get_by_role("button", name=name, exact=True)
    expect(button).to_be_enabled()
    go_to(page, button)
    page.keyboard.press(key)


def test_from_the_plan_to_the_end_without_a_pointer(service: Service, machine: VirtualMachine, page: Page) -> None:
    expect(page.locator("#machine")).to_have_text("all axes stand without energy")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent").startswith("STOP")  # first in the order

    pages = page.get_by_role("navigation", name="Pages")
    go_to(page, pages.get_by_role("link", name="Plan", exact=True))
    page.keyboard.press("Enter")
    expect(page.locator("#axes-measured input")).to_have_count(6)
    for joint in ("joint_2", "joint_3"):
        go_to(page, page.locator(f"#axes-measured [value={joint}]"))
        page.keyboard.press("Space")
    go_to(page, page.locator("#amount"))
    page.keyboard.press("Control+A")
    page.keyboard.type("2")
    press(page, "Make the plan")
    expect(page.locator("#planned")).to_be_visible()
    press(page, "Make a campaign of it (nothing moves)")
    go_to(page, page.locator("#taken a"))
    page.keyboard.press("Enter")

    press(page, "Start", "Space")
    until(lambda: not machine.stands(), "an axis with energy")
    press(page, "Abort")
    expect(page.locator("#abort-question")).to_contain_text("End campaign 1 permanently?")
    press(page, "Keep campaign")
    expect(page.locator("#campaign-state")).to_have_text("running")
    page.keyboard.press("F8")
    until(machine.stands, "standing axes")
    expect(page.locator("#held-by")).to_contain_text("Stopped by operator page")
    name = page.get_by_label("Your name")
    go_to(page, name)
    page.keyboard.type("Ada")
    press(page, "Machine checked: release")
    expect(page.locator("#held")).to_be_hidden()

    press(page, "Abort")
    expect(page.locator("#abort-question")).to_be_visible()
    press(page, page.locator("#abort-yes").inner_text())
    expect(page.locator("#campaign-state")).to_have_text("aborted")
    with ServiceClient(service.url) as client:
        assert client.campaigns()[-1]["state"] == "aborted"
