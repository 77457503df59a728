"""Reports as PDF: printed by the browser that is installed, or refused before the work begins."""

from __future__ import annotations

import os
import re
import sys
import zlib
from pathlib import Path

import pytest

from calib.errors import CalibError, FileError
from calib.show.blocks import Page
from calib.show.report_file import check_report, find_browser, report_bytes
from tests.browser import CHROMIUM, NEEDED

#: A program that writes an empty file where a browser prints.
EMPTY = "import sys; [open(a.partition('=')[2], 'w') for a in sys.argv if a.startswith('--print-to-pdf=')]"

#: A page without figures.
PAGE = Page("Report", "of nothing", ())


def starter(folder: Path, name: str, script: str) -> None:
    """A program of this name."""
    path = folder / name
    path.write_text(f"#!{sys.executable}\n{script}\n")
    path.chmod(0o755)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason=NEEDED)
def test_a_report_is_printed_on_a4(calibrations, tmp_path: Path):
    result = calibrations.made("one_row")
    path = result.write_report(tmp_path / "report.PDF")
    data = path.read_bytes()
    assert data.startswith(b"%PDF")
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", data)) <= 20
    boxes = re.findall(rb"/MediaBox\s*\[0 0 ([\d.]+) ([\d.]+)\]", data)
    assert {(round(float(w)), round(float(h))) for w, h in boxes} == {(595, 842)}
    # Neither the browser's header nor the place of the page in its footer.
    text = b"".join(
        zlib.decompress(stream)
        for stream in re.findall(rb"/FlateDecode[^>]*>>\s*stream\r?\n(.*?)endstream", data, re.S)
        if stream[:1] == b"x"
    )
    assert b"page.html" not in data + text
    with pytest.raises(FileError):
        result.write_report(path)


def test_the_ending_says_which(tmp_path: Path):
    assert report_bytes(PAGE, tmp_path / "r.htm").lstrip().lower().startswith(b"<!doctype html>")
    check_report("r.html")
    for name in ("r.txt", "r", "r.pdf.zip"):
        with pytest.raises(FileError, match=r"\.html or \.pdf"):
            check_report(name)


@pytest.mark.skipif(
    sys.platform != "linux", reason="other systems have browsers outside of the PATH"
)
def test_without_a_browser_there_is_no_pdf(monkeypatch, call, shop: Path, tmp_path: Path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_browser() is None
    words = ("robot.urdf", "data.csv", "--base", "base", "--report", "r.pdf", "--json", "r.json")
    for verb in ("calibrate", "evaluate"):
        done = call(shop, verb, *words)
        assert (done.code, done.out) == (1, "")
        assert "Chromium, Chrome or Edge" in done.err
        assert not (shop / "r.json").exists()


@pytest.mark.skipif(os.name != "posix", reason="programs are scripts here")
@pytest.mark.parametrize("script", ["", "import sys; sys.exit(1)", EMPTY])
def test_a_browser_that_does_not_print(monkeypatch, tmp_path: Path, script: str):
    starter(tmp_path, "google-chrome", script)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_browser() == str(tmp_path / "google-chrome")
    with pytest.raises(CalibError, match=r"did not print|printed no PDF"):
        report_bytes(PAGE, "r.pdf")
