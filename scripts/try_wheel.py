"""Install a wheel into an environment of its own, outside of the checkout, and use it as its users do.

    python scripts/try_wheel.py dist/robot_calib-0.1.0-py3-none-any.whl

First without any extra: the five lines of the README; what an extra is needed for must say which one. Then with all
extras: `calib demo`. Then, if uv is installed, the small installation of docs/install.md: the demo, and a picture of a
robot whose meshes are .dae files.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

#: The README's five lines, on the data that the wheel brings.
PROGRAM = """\
import calib
from calib.example import paper_measurements, paper_urdf

robot = calib.Robot.load(paper_urdf(), base="base", tip="tool0")
data = calib.Measurements.read(paper_measurements(), robot.joint_names)
result = calib.calibrate(robot, data)
print(result.summary())
result.write_urdf("corrected.urdf")
result.write_json("result.json")
print(calib.__file__)
"""


def run(*command: str | Path, folder: Path, succeeds: bool = True) -> str:
    """Run a command in a folder; return what it printed, or end this program if it did not end as expected."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    if (done.returncode == 0) != succeeds:
        print(done.stdout)
        sys.exit(f"{' '.join(map(str, command))}: exit status {done.returncode}")
    return done.stdout


def main() -> None:
    """Build the environment and use the wheel in it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("wheel", type=Path)
    wheel = parser.parse_args().wheel.resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        venv.create(folder / "venv", with_pip=True)
        programs = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
        python, calib = programs / "python", programs / "calib"
        install = (python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")

        run(*install, wheel, folder=folder)
        where = run(python, "-c", PROGRAM, folder=folder).splitlines()[-1]
        if not Path(where).resolve().is_relative_to(folder.resolve()):
            sys.exit(f"the checkout was imported, not the wheel: {where}")
        refused = run(calib, "demo", "--out", "without", folder=folder, succeeds=False)
        if "robot-calib[report]" not in refused:
            sys.exit(f"without the extra 'report' the demo says: {refused}")
        packages = run(python, "-m", "pip", "list", folder=folder).count("\n") - 2

        run(*install, f"{wheel}[all]", folder=folder)
        run(calib, "demo", "--out", "demo", folder=folder)
        written = sorted(path.name for path in (folder / "demo").iterdir())
        print(f"{wheel.name}: {packages} packages without extras; the demo wrote {written}")

        uv = Path(sys.executable).with_name("uv")
        if uv.exists():
            page = Path(__file__).parents[1].joinpath("docs", "install.md").read_text("utf-8")
            (folder / "overrides.txt").write_text(page.split("```text\n")[1].split("```")[0])
            small = folder / "small" / programs.name
            venv.create(small.parent)
            install_small = (uv, "pip", "install", "--quiet", "--python", small / "python")
            run(*install_small, "--override", "overrides.txt", f"{wheel}[report]", folder=folder)
            run(small / "calib", "demo", "--out", "small-demo", folder=folder)
            drawn = run(small / "calib", "view", "ur5", "-o", "ur5.html", folder=folder)
            if "Not drawn" in drawn:
                sys.exit(f"the small installation lacks what reads meshes: {drawn}")
            counted = run(uv, "pip", "freeze", "--python", small / "python", folder=folder)
            print(f"small installation: {len(counted.splitlines())} packages with 'report'")


if __name__ == "__main__":
    main()
