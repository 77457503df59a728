"""The app in Chromium at three sizes, by the keyboard alone: from files to the verdict, a session, a check."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.example import paper_measurements, paper_urdf
from tests.browser import Browser
from tests.verbs.app.measured import begun, operator
from tests.verbs.app.served import Client, served
from tests.verbs.app.windows import SIZES, Window, window
from tests.verbs.check.shop import POSES, paper_result, points, write_rows

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("size", SIZES)
def test_from_files_to_the_verdict_by_keys(browser: Browser, client: Client, size: str):
    with window(browser, client, "/open", size) as page:
        page.check("open")
        page.tab_to("#files")
        page.choose_files("#files", paper_urdf(), paper_measurements())
        page.until("document.querySelectorAll('.chosen li').length === 2")
        page.tab_to("form.open button.main")
        page.key("Enter")
        page.wait_for("#reading")
        page.check("draft")
        page.tab_to("#f-serial")
        page.write("SN-1")
        page.tab_to("button[value=calibrate]")
        page.key("Enter")
        page.wait_for("#progress")
        page.check("run")
        page.wait_for(".verdict.good")
        page.tab.evaluate("document.querySelector('iframe').scrollIntoView()")
        page.check("result")
        page.tab_to(
            "[role=region]"
        )  # in the frame of the 3-D page keys would go to a process of its own
        page.go("/history")
        page.wait_for(".timeline")
        page.check("history")


@pytest.mark.parametrize("size", SIZES)
def test_a_session_of_twelve_poses_by_keys(browser: Browser, client: Client, size: str):
    job = begun(client)
    person = operator()
    with window(browser, client, job, size) as page:
        page.wait_for("#entry")
        page.check("measure-begin")
        for count in range(1, 13):
            add(page, person)
            if count == 6:
                page.check("measure-middle")
        page.check("measure")
        page.tab_to("#note")
        page.write("warm, 5 kg")
        page.key("Enter")
        page.wait_for("#notes")
        page.tab_to("form[action$=undo] button")
        page.key("Enter")
        page.until("document.querySelectorAll('.stops li').length === 11")
        page.tab_to("form[action$=finish] button")
        page.key("Enter")
        page.wait_for(".headlines")
        page.check("measure-result")


def add(page: Window, person) -> None:  # type: ignore[no-untyped-def]
    """Read the pose from the page, and type what the tracker shows."""
    row = page.tab.evaluate("document.getElementById('row').textContent")
    again = page.tab.evaluate("document.getElementById('next').textContent.startsWith('Again')")
    q = np.deg2rad([float(value) for value in row.split()])
    xyz = 1e3 * person.measure(q, again=again).readings.points[0]
    before = page.tab.evaluate("document.querySelector('[data-version]').dataset.version")
    # The first field has the focus already: one types, and the next one is a Tab away.
    page.until("document.activeElement.id === 'v-target-1'")
    for k, value in enumerate(xyz):
        if k:
            page.key("Tab")
        page.write(f"{value:.3f}".replace(".", ","))
    page.key("Enter")
    page.wait_for(f"[data-version]:not([data-version='{before}'])")
    page.wait_for("#entry")


@pytest.mark.parametrize("size", SIZES)
def test_a_check_by_keys(browser: Browser, client: Client, tmp_path: Path, size: str):
    paper_result().write_json(client.folder / "result.json")
    rows = write_rows(points(POSES, target=(0.003, 0.0, 0.0)), tmp_path / "morning.csv")
    with window(browser, client, "/check", size) as page:
        page.check("check")
        page.tab_to("#files")
        page.choose_files("#files", rows)
        page.tab_to("form[action='/check'] button.main")
        page.key("Enter")
        page.wait_for(".verdict.bad")
        page.check("checked")
        page.go("/check")
        page.wait_for("#count")
        page.tab_to("form[action='/check/poses'] button")
        page.key("Enter")
        page.wait_for("table.sheet")
        page.check("poses")


def test_what_one_browser_does_another_shows(browser: Browser, client: Client):
    job = begun(client)
    person = operator()
    with (
        window(browser, client, job, "desk") as first,
        window(browser, client, job, "tablet") as second,
    ):
        second.wait_for("#entry")
        first.wait_for("#entry")
        add(first, person)
        second.says("Stops that count: 1.")
        poses = [
            one.tab.evaluate("document.getElementById('row').textContent")
            for one in (first, second)
        ]
        assert poses[0] == poses[1]
        # What is being typed stays, and is not taken for the pose that came meanwhile.
        second.until("document.activeElement.id === 'v-target-1'")
        second.write("1")
        add(first, person)
        second.says("Stops that count: 2.")
        assert second.tab.evaluate("document.activeElement.value") == "1"
        second.key("Tab")
        second.write("2")
        second.key("Tab")
        second.write("3")
        second.key("Enter")
        second.wait_for("p.banner.bad")
        assert "Nothing was added" in second.tab.evaluate("document.body.textContent")
        assert second.tab.evaluate("document.getElementById('v-target-1').value") == "1"


def test_the_numbers_are_read_from_two_metres(browser: Browser, client: Client):
    job = begun(client)
    for size in SIZES:
        with window(browser, client, job, size) as page:
            page.wait_for(".joints .numerals")
            sizes = page.tab.evaluate(
                "[...document.querySelectorAll('.joints .numerals')]"
                ".map((e) => parseFloat(getComputedStyle(e).fontSize))"
            )
            assert min(sizes) >= (30.0 if size == "phone" else 48.0)  # a phone is in the hand


def test_dark_and_german(browser: Browser, tmp_path: Path):
    with served(tmp_path, "de") as client:
        client.enter()
        job = begun(client)
        with window(browser, client, "/open", "desk") as page:
            page.tab_to("select[name=theme]")
            page.key("ArrowDown")
            page.key("ArrowDown")
            page.key("Enter")
            page.until("document.documentElement.dataset.theme === 'dark'")
            page.check("open-dark")
            ground = page.tab.evaluate("getComputedStyle(document.documentElement).backgroundColor")
            assert max(int(part) for part in ground[4:-1].split(",")) < 60
            for path, name in ((job, "measure-dark"), ("/history", "history-dark")):
                page.go(path)
                page.check(name)
            assert "Nächste Messpose" in client.get(job).text


def test_without_scripts_every_page_works(browser: Browser, client: Client):
    """A browser that runs no script goes by forms and reloading."""
    with window(browser, client, "/open", "desk") as page:
        page.tab._call("Emulation.setScriptExecutionDisabled", value=True)
        page.tab._call("Page.reload")
        page.wait_for("#files")
        page.choose_files("#files", paper_urdf(), paper_measurements())
        page.tab_to("form.open button.main")
        page.key("Enter")
        page.wait_for("#reading")
        page.tab_to("button[value=calibrate]")
        page.key("Enter")
        page.wait_for(".verdict.good")


def test_the_first_key_skips_to_the_content(browser: Browser, client: Client):
    with window(browser, client, "/open", "phone") as page:
        page.key("Tab")
        assert page.tab.evaluate("document.activeElement.className") == "skip"
        page.key("Enter")
        assert page.tab.evaluate("location.hash") == "#content"
        page.key("Tab")
        assert page.tab.evaluate("document.activeElement.id") == "files"
