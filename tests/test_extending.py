"""The programs of docs/extending.md, each in a process of its own: what they register must not reach other tests."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from tests.places import ROOT

PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
SECTIONS = [part for part in re.split(r"^## ", PAGE, flags=re.MULTILINE) if "```python" in part]


@pytest.mark.slow
@pytest.mark.parametrize("section", SECTIONS, ids=lambda part: part.partition("\n")[0])
def test_the_page_s_programs_run(section, tmp_path):
    program = tmp_path / "program.py"
    program.write_text("\n".join(re.findall(r"```python\n(.*?)```", section, re.DOTALL)))
    run = subprocess.run(
        [sys.executable, program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr


def test_nothing_in_calib_knows_the_examples():
    sources = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "calib").rglob("*.py"))
    names = re.findall(r'name="(\w+)"', PAGE)
    assert names
    assert not [name for name in names if f'"{name}"' in sources]
