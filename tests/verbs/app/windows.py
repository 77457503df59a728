"""The app in a real browser: windows of three sizes, driven by keys alone, and what every page must keep."""

from __future__ import annotations

import base64
import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.browser import Browser, BrowserError, Tab
from tests.verbs.app.served import Client

#: A phone in the hand, a tablet beside the robot, a desk [px].
SIZES = {"phone": (412, 860), "tablet": (820, 1180), "desk": (1400, 900)}

#: Where pictures of all pages are kept, if somebody wants to look at them; empty: nowhere.
PICTURES = os.environ.get("CALIB_APP_PICTURES", "")

#: Keys without a letter.
_CODES = {"Tab": 9, "Enter": 13, "Escape": 27, " ": 32, "ArrowDown": 40, "ArrowUp": 38}

#: Text below this size is too small [px].
_LEAST = 12.0

#: Elements whose own text is smaller than it may be, as it is drawn: text in SVG is scaled.
_SMALL = """
[...document.querySelectorAll("body *")].filter((e) => {
  if (![...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim())) return false;
  if (!e.getClientRects().length || e.closest(".hidden, noscript, script, style")) return false;
  let size = parseFloat(getComputedStyle(e).fontSize);
  const svg = e.ownerSVGElement;
  if (svg) size *= svg.getScreenCTM().a;
  return size < LEAST;
}).map((e) => e.outerHTML.slice(0, 120))
"""

#: Elements that stick out to the right, but for those in boxes that scroll by themselves.
_WIDE = """
document.documentElement.scrollWidth <= innerWidth ? [] :
[...document.querySelectorAll("body *")].filter((e) => e.getBoundingClientRect().right > innerWidth + 1
  && !e.closest(".wide, pre, .skip")).slice(0, 5).map((e) => e.outerHTML.slice(0, 120))
"""

#: Controls without a name that a screen reader could say, and identifiers that occur twice.
_NAMELESS = """
[...document.querySelectorAll("input:not([type=hidden]), select, button, a, iframe, svg[role=img], summary")]
.filter((e) => !(e.labels && e.labels.length) && !e.getAttribute("aria-label") && !e.title && !e.textContent.trim())
.map((e) => e.outerHTML.slice(0, 120)).concat([...document.querySelectorAll("[id]")].map((e) => e.id)
.filter((id, k, all) => all.indexOf(id) !== k))
"""


class Window:
    """A page in a window of a size, operated by keys."""

    def __init__(self, tab: Tab, size: str) -> None:
        self.tab, self.size = tab, size

    def key(self, name: str, *, shift: bool = False) -> None:
        """Press a key."""
        words = {"key": name, "code": name, "windowsVirtualKeyCode": _CODES[name]}
        if shift:
            words["modifiers"] = 8
        text = {"text": "\r"} if name == "Enter" else {"text": " "} if name == " " else {}
        self.tab._call("Input.dispatchKeyEvent", type="keyDown", **words, **text)
        self.tab._call("Input.dispatchKeyEvent", type="keyUp", **words)

    def write(self, text: str) -> None:
        """Type letters."""
        for letter in text:
            self.tab._call("Input.dispatchKeyEvent", type="keyDown", text=letter, key=letter)
            self.tab._call("Input.dispatchKeyEvent", type="keyUp", key=letter)

    def tab_to(self, selector: str) -> None:
        """Press Tab until an element has the focus, and see that this can be seen."""
        self.tab.evaluate(
            "document.activeElement === document.body || document.activeElement.blur()"
        )
        wanted = f"document.activeElement && document.activeElement.matches({json.dumps(selector)})"
        for _ in range(200):
            self.key("Tab")
            if self.tab.evaluate(wanted):
                break
        else:
            raise AssertionError(f"{selector} is not reached by Tab")
        self.until("parseFloat(getComputedStyle(document.activeElement).outlineWidth) >= 2", 2.0)

    def choose_files(self, selector: str, *paths: Path) -> None:
        """Choose files, as the dialog of the system would."""
        node = self.tab._call(
            "Runtime.evaluate", expression=f"document.querySelector({json.dumps(selector)})"
        )
        names = [str(path) for path in paths]
        self.tab._call("DOM.setFileInputFiles", files=names, objectId=node["result"]["objectId"])

    def until(self, condition: str, timeout: float = 60.0) -> None:
        """Wait until something is true, through any reloading."""
        end = time.monotonic() + timeout
        while True:
            with suppress(BrowserError):  # the page is just being replaced
                if self.tab.evaluate(condition):
                    return
            assert time.monotonic() < end, condition
            time.sleep(0.05)

    def wait_for(self, selector: str, timeout: float = 60.0) -> None:
        """Wait until an element is there."""
        self.until(f"!!document.querySelector({json.dumps(selector)})", timeout)

    def says(self, text: str) -> None:
        """Wait until the page has a text."""
        self.until(f"document.body.textContent.includes({json.dumps(text)})")

    def go(self, path: str) -> None:
        """Go to another page."""
        self.tab.evaluate(f"location.assign({json.dumps(path)})")
        self.until(
            f"location.pathname === {json.dumps(path)} && document.readyState === 'complete'"
        )

    def check(self, name: str) -> None:
        """See that the page scrolls down only, has no small text, names all controls, and the browser is content."""
        self.until("document.readyState === 'complete'")
        picture(self, name)
        assert self.tab.evaluate(_WIDE) == [], name
        assert self.tab.evaluate(_SMALL.replace("LEAST", str(_LEAST))) == [], name
        assert self.tab.evaluate(_NAMELESS) == [], name
        assert self.tab.complaints == [], name
        assert self.tab.elsewhere == [], name


def picture(window: Window, name: str) -> None:
    """Keep a picture of the whole page, if somebody wants to look at it."""
    if not PICTURES:
        return
    tab = window.tab
    time.sleep(0.3)
    size = tab._call("Page.getLayoutMetrics")["cssContentSize"]
    clip = {"x": 0, "y": 0, "width": size["width"], "height": min(size["height"], 6000), "scale": 1}
    answer = tab._call(
        "Page.captureScreenshot", format="png", captureBeyondViewport=True, clip=clip
    )
    folder = Path(PICTURES)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}-{window.size}.png").write_bytes(base64.b64decode(answer["data"]))


@contextmanager
def window(browser: Browser, client: Client, path: str, size: str) -> Iterator[Window]:
    """A window of its own with a page of the app, which it entered by the printed address."""
    joint = "&" if "?" in path else "?"
    with browser.open(f"http://{client.host}{path}{joint}token={client.token}", SIZES[size]) as tab:
        yield Window(tab, size)
