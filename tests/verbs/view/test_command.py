"""calib view: robots as a page, from the real program."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

SMALL = """<robot name="small">
  <link name="floor"/><link name="arm"/><link name="hand"/>
  <joint name="turn" type="revolute"><parent link="floor"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="lift" type="prismatic"><parent link="arm"/><child link="hand"/><origin xyz="0.5 0 0"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""


@pytest.mark.slow
@pytest.mark.parametrize("has_browser", [True, False])
def test_without_a_name_the_page_is_a_temporary_file_that_the_browser_opens(
    program, tmp_path, has_browser
):
    (tmp_path / "small.urdf").write_text(SMALL)
    (tmp_path / "browser.py").write_text("import sys; open('opened', 'w').write(sys.argv[1])")
    names = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
    environment = {name: value for name, value in os.environ.items() if name not in names}
    environment["TMPDIR"] = str(tmp_path)
    if has_browser:
        environment["BROWSER"] = f"{sys.executable} browser.py %s"
    done = subprocess.run(
        [*program, "view", "small.urdf"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        encoding="utf-8",
    )
    (page,) = tmp_path.glob("calib-*/view.html")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"Written: {page}\n", "")
    assert "turn at" in page.read_text(encoding="utf-8")
    opened = tmp_path / "opened"
    assert opened.exists() is has_browser
    assert not has_browser or opened.read_text() == page.as_uri()


def test_the_examples_write_pages(examples):
    one = examples.starting("calib view robot.urdf --base base -o")
    assert (one.code, one.out, one.err) == (0, "Written: robot.html\n", "")
    both = examples.starting("calib view robot.urdf --calibration result.json")
    assert (both.code, both.out) == (0, "Written: both.html\n")
    text = (examples.folder / "both.html").read_text(encoding="utf-8")
    assert "joint origins of result.json" in text
    assert "Verdict: use." in text
