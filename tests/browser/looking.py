"""What a person would see of a page: green things, texts too faint to read, targets too small to hit."""

from typing import cast

from playwright.sync_api import Page

# every colour as the browser paints it: names, percentages and light-dark() come out as four bytes
_COLOURS = """
const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
const bytes = (colour) => {
  canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = colour; canvas.fillRect(0, 0, 1, 1);
  return [...canvas.getImageData(0, 0, 1, 1).data];
};
const written = (one) => [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
const seen = [...document.querySelectorAll("body *")].filter((one) => one.checkVisibility() && !one.closest("svg"));
"""
_GREEN = (
    "() => {"
    + _COLOURS
    + """
  const green = ([r, g, b, alpha]) => alpha > 60 && g > 1.25 * r && g > 1.1 * b;
  return seen.filter((one) => {
    const style = getComputedStyle(one);
    const painted = [style.color, style.backgroundColor];
    for (const side of ["Left", "Top"]) {
      if (parseFloat(style[`border${side}Width`]) > 0) painted.push(style[`border${side}Color`]);
    }
    if (one.tagName === "PROGRESS") painted.push(style.accentColor);
    return painted.some((colour) => green(bytes(colour)));
  }).map((one) => one.id || `${one.tagName} ${one.textContent.slice(0, 40)}`);
}"""
)
_ALARMS = (
    "() => {"
    + _COLOURS
    + """
  const alarm = ([r, g, b, alpha]) => alpha > 60 && r > 1.35 * Math.max(g, b);
  return seen.filter((one) => one.id !== "stop").filter((one) => {
    const { color, backgroundColor } = getComputedStyle(one);
    return alarm(bytes(backgroundColor)) || (written(one) && alarm(bytes(color)));
  }).map((one) => one.textContent.trim().replace(/\\s+/g, " ") || one.tagName);
}"""
)
_FAINT = (
    "() => {"
    + _COLOURS
    + """
  const over = (upper, lower) => upper.slice(0, 3).map((c, k) => (c * upper[3] + lower[k] * (255 - upper[3])) / 255);
  const behind = (one) => {
    if (!one) return [255, 255, 255];
    const own = bytes(getComputedStyle(one).backgroundColor);
    return own[3] === 255 ? own.slice(0, 3) : over(own, behind(one.parentElement));
  };
  const light = (rgb) => {
    const [r, g, b] = rgb.map((c) => (c / 255 <= 0.04045 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  return seen.filter((one) => written(one) && !one.closest("[disabled], option")).map((one) => {
    const style = getComputedStyle(one), ground = behind(one);
    const [high, low] = [light(over(bytes(style.color), ground)), light(ground)].sort((x, y) => y - x);
    const large = parseFloat(style.fontSize) >= 24 || (parseFloat(style.fontSize) >= 18.66 && style.fontWeight >= 700);
    return [(high + 0.05) / (low + 0.05), large ? 3 : 4.5, one.textContent.trim().slice(0, 40)];
  }).filter(([contrast, least]) => contrast < least).map(([contrast, , text]) => `${contrast.toFixed(2)}: ${text}`);
}"""
)
_TARGETS = "button, select, nav a, input:not([type=checkbox]), summary, label:has([type=checkbox])"
_SMALL = """(targets) => [...document.querySelectorAll(targets)]
  .filter((one) => one.checkVisibility())
  .map((one) => [one.getBoundingClientRect(), one.textContent.trim() || one.id])
  .filter(([box]) => box.height < 48 || box.width < 48)
  .map(([box, name]) => `${name}: ${box.width.toFixed(0)} x ${box.height.toFixed(0)}`)"""

_CUT = """() => [...document.querySelectorAll("section, header, #head")]
  .filter((one) => one.checkVisibility() && one.scrollWidth > one.clientWidth)
  .map((one) => `${one.id || one.textContent.trim().slice(0, 40)}: ${one.scrollWidth} in ${one.clientWidth}`)"""


_OTHER_INK = """() => [...document.querySelectorAll(".js-plotly-plot text")]
  .filter((one) => one.checkVisibility() && getComputedStyle(one).fill !== getComputedStyle(document.body).color)
  .map((one) => one.textContent)"""


_OVERLAPS = """([labels, others]) => {
  const boxes = (found) => [...document.querySelectorAll(found)].map((one) => one.getBoundingClientRect());
  const taken = boxes(others).filter((one) => one.width >= 1);
  const meet = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  const frame = document.querySelector(labels).closest("svg").getBoundingClientRect();
  return boxes(labels).filter((one) => one.left < frame.left || taken.some((other) => meet(one, other))).length;
}"""


def overlaps(page: Page, labels: str, others: str) -> int:
    """How many labels reach out of their figure or over other marks; both by their selectors."""
    return int(page.evaluate(_OVERLAPS, [labels, others]))


def unlike_ink(page: Page) -> list[str]:
    """Texts of charts in another colour than the page's own, as of a chart drawn before the scheme changed."""
    return cast("list[str]", page.evaluate(_OTHER_INK))


def green(page: Page) -> list[str]:
    """Everything on the page that is painted green."""
    return cast("list[str]", page.evaluate(_GREEN))


def alarms(page: Page) -> list[str]:
    """Texts in red or amber, of any shade, and what is painted so behind them or without any."""
    return cast("list[str]", page.evaluate(_ALARMS))


def faint(page: Page) -> list[str]:
    """Texts below the contrast of WCAG 2.2 AA (1.4.3): 4.5, of large ones 3; what is disabled is exempt."""
    return cast("list[str]", page.evaluate(_FAINT))


def small(page: Page) -> list[str]:
    """What a gloved finger would miss: controls below 48 px."""
    return cast("list[str]", page.evaluate(_SMALL, _TARGETS))


def too_wide(page: Page) -> bool:
    """Must the page be scrolled sideways?"""
    return bool(page.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth"))


def cut(page: Page) -> list[str]:
    """Panels that must be scrolled sideways."""
    return cast("list[str]", page.evaluate(_CUT))


def settled(page: Page) -> None:
    """Until what was asked for is drawn; the second frame has the layout of the first."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
