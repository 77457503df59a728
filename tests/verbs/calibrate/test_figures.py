"""The list of figures: those that apply, and that every one can be made for every kind of calibration."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest

from calib.errors import CalibError, FileError
from calib.show.plotting import render
from calib.verbs.calibrate import figures
from calib.verbs.calibrate.figures import CAPTIONS, drawings, write_figures

#: Figures that are soon drawn.
QUICK = ("error-curves", "singular-values")

ALWAYS = ["points", "histograms", "singular-values"]

#: Figures of every result whose accuracy is known.
OF_UNCERTAINTY = {"uncertainty-budget", "workspace-uncertainty"}


@pytest.mark.parametrize(
    ("case", "present", "absent"),
    [
        pytest.param("auto", ["candidates"], [], marks=pytest.mark.slow),
        ("poses", ["orientation-errors-by-pose", "orientation-errors-by-axis"], ["candidates"]),
        ("mixed", ["orientation-errors-by-pose", "errors-by-pose"], []),
        ("distances", ["error-curves", "residual-by-joint"], ["errors-by-axis"]),
        ("three_rows", ["error-curves"], ["correlations"]),
        ("one_row", ["parameter-changes"], ["correlations", "convergence"]),
    ],
)
def test_figures_are_those_that_apply(calibrations, case, present, absent):
    c = calibrations.made(case)
    names = [drawing.name for drawing in drawings(c)]
    assert OF_UNCERTAINTY & set(names) == (set() if c.unknown_accuracy else OF_UNCERTAINTY)
    assert set(present) | set(ALWAYS) <= set(names)
    assert not set(absent) & set(names)
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("case", ["paper", "poses", "distances", "one_row"])
def test_every_caption_says_which_rows_and_units(calibrations, case):
    for drawing in drawings(calibrations.made(case)):
        assert re.search(r"\brows?\b|over [\d,]+ poses", drawing.caption), drawing.name
        assert not re.search(r"[{}]|UNIT", drawing.caption)
        if drawing.section == "errors" and drawing.name != "histograms":
            assert re.search(r"\[(mm|deg)\]", drawing.caption), drawing.name


def check_svg(svg):
    """Small, well formed, nothing but a picture."""
    assert len(svg) < 500_000
    tags = {element.tag.split("}")[1] for element in ElementTree.fromstring(svg).iter()}
    assert not tags & {"script", "b", "i", "foreignObject"}
    assert not re.search(rb'href="(?!#|data:image/png)', svg)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["hostile_names", "many_rows"])
def test_every_figure_is_made_and_holds_text_only_as_text(calibrations, case):
    c = calibrations.many_rows(6000) if case == "many_rows" else calibrations.made(case)
    for drawing in drawings(c):
        check_svg(render(drawing, "svg"))


def test_all_are_written_and_none_is_written_over(calibrations, tmp_path, monkeypatch):
    quick = {name: figures.FIGURES[name] for name in QUICK}
    monkeypatch.setattr(figures, "FIGURES", quick)
    c = calibrations.made("one_row")
    calls = []
    folder = tmp_path / "new" / "figures"
    paths = write_figures(
        c, folder, kind="svg", progress=lambda done, every: calls.append((done, every))
    )
    names = [drawing.name for drawing in drawings(c)]
    assert [path.name for path in paths] == [f"{name}.svg" for name in names]
    assert sorted(folder.iterdir()) == sorted([*paths, folder / CAPTIONS])
    assert calls == [(k + 1, len(names)) for k in range(len(names))]
    paths[0].unlink()
    paths[1].write_text("kept")
    with pytest.raises(FileError, match=rf"{names[1]}\.svg exists already"):
        write_figures(c, folder, kind="svg")
    assert paths[1].read_text() == "kept"
    assert not paths[0].exists()  # refused before anything was drawn
    assert write_figures(c, folder, kind="svg", overwrite=True) == paths
    for path in paths:
        check_svg(path.read_bytes())
    text = (folder / CAPTIONS).read_text(encoding="utf-8")
    for drawing in drawings(c):
        entry = f"## {drawing.name}.svg\n\n**{drawing.title}.** {drawing.caption}\n"
        assert entry in text


def test_a_figure_of_the_report_is_drawn_by_its_name(calibrations):
    from matplotlib.figure import Figure

    result = calibrations.made("paper")
    assert result.figures == tuple(drawing.name for drawing in drawings(result))
    assert "image-residuals" not in result.figures
    figure = result.plot("error-curves")
    assert isinstance(figure, Figure)
    assert figure.axes
    for name in ("error-curve", "image-residuals"):
        with pytest.raises(CalibError, match="'error-curves'"):
            result.plot(name)
