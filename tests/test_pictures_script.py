"""The pictures in README and docs show what the demo shows now."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path

import pytest
from PIL import Image

from tests.show.calibrations import made

ROOT = Path(__file__).parents[1]


def script():
    """scripts/pictures.py as a module."""
    spec = importlib.util.spec_from_file_location("pictures", ROOT / "scripts" / "pictures.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault("pictures", module)  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def pictures():
    return script()


@pytest.mark.parametrize("name", ["view.png", "overlaid.png", "report.png"])
def test_the_picture_was_taken_of_what_is_shown_now(pictures, name):
    (picture,) = [one for one in pictures.PICTURES if one.name == name]
    with Image.open(ROOT / "docs" / name) as image:
        taken = image.text[pictures.MADE_FROM]
        assert image.size == picture.size
        # Not blank: the scene has hundreds of colours, the report some.
        assert image.convert("RGB").getcolors(100) is None
    assert taken == pictures.made_from(picture, made("paper")), "run scripts/pictures.py"


def test_every_picture_taken_is_shown_and_every_picture_shown_is_there(pictures):
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    shown = {
        Path(link).name
        for page in pages
        for link in re.findall(r"!\[[^\]]*\]\(([^)]+\.png)\)", page.read_text(encoding="utf-8"))
    }
    assert shown == {picture.name for picture in pictures.PICTURES}
