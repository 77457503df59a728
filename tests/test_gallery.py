"""The gallery of verdicts: its commands print what stands on the page."""

from __future__ import annotations

import sys

import pytest

from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

from gallery import DOCS, verdict

SECTIONS = (DOCS / "gallery.md").read_text(encoding="utf-8").split("\n## ")[1:]


@pytest.mark.slow
def test_the_commands_of_the_gallery_print_its_verdicts(tmp_path):
    for section in SECTIONS:
        printed = verdict(section, tmp_path)
        assert printed in section, section.splitlines()[0]
    uses = {section.split("Verdict: ")[1].splitlines()[0] for section in SECTIONS}
    assert uses == {"use", "use with care", "do not use"}
