"""``calib calibrate --report`` and ``--figures``: what is written, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

FIT = ("fit", "robot.urdf", "data.csv", "--base", "base", "--tip", "tool0", "--model", "zeros")


def test_report_and_figures_are_written_and_named(examples):
    call = (
        "calib calibrate robot.urdf data.csv --base base --no-validate --report report.html --figures figures "
        "--figure-format svg"
    )
    done = examples.done[call]
    figures = sorted(path.name for path in (examples.folder / "figures").iterdir())
    figures.remove("captions.md")
    assert len(figures) >= 10
    assert all(name.endswith(".svg") for name in figures)
    assert "points.svg" in figures
    assert "Written: report.html" in done.lines
    assert f"Written: figures ({len(figures)} figures)" in done.lines
    report = (examples.folder / "report.html").read_text(encoding="utf-8")
    assert "<title>Calibration report: robot ur3</title>" in report
    assert '<span class="word">--figure-format</span> <span class="word">svg</span>' in report


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--report", "r.md"), "'r.md': a report is a page or a PDF; let the name end in"),
        (("--report", "-"), "'-': a report is a page or a PDF; let the name end in"),
        (
            ("--report", "none/r.html"),
            "does not exist; create it",
        ),
        (
            ("--report", "r.html", "--json", "r.html"),
            "r.html is also another output of this command",
        ),
        (("--figure-format", "svg"), "--figure-format takes --figures FOLDER"),
        (
            ("--figures", "cell.toml"),
            "cell.toml is a file; --figures names a folder",
        ),
    ],
)
def test_what_cannot_be_written_is_refused_before_the_work(call, shop: Path, words, said: str):
    before = sorted(shop.iterdir())
    done = call(shop, *FIT, *words)
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith("calib: ")
    assert said in done.err
    assert done.err.count("\n") == 1
    assert sorted(shop.iterdir()) == before


def test_a_figure_that_exists_is_kept_and_nothing_is_written(call, shop: Path):
    (shop / "figures").mkdir()
    (shop / "figures" / "points.png").write_text("mine", encoding="utf-8")
    done = call(shop, *FIT, "--no-validate", "--figures", "figures", "--json", "r.json")
    assert (done.code, done.out) == (1, "")
    assert done.err == (
        "calib: figures/points.png exists already; add --force or choose another folder.\n"
    )
    assert [path.name for path in (shop / "figures").iterdir()] == ["points.png"]
    assert not (shop / "r.json").exists()
