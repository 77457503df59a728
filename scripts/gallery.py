"""Run the commands of the gallery of verdicts, ``docs/gallery.md``, and put what they print and draw into it.

    python scripts/gallery.py

Each section has a cell file or none, commands, the verdict that they print, and a figure, whose alternative text ends
with the name under which ``calib calibrate --figures`` writes it. Verdicts and figures are written anew.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"

_CELL = re.compile(r"`(\S+\.toml)`:\n\n```toml\n(.*?)```", re.DOTALL)
_COMMANDS = re.compile(r"```sh\n(.*?)```", re.DOTALL)
_VERDICT = re.compile(r"(?<=```text\n).*?(?=```)", re.DOTALL)
_FIGURE = re.compile(r"!\[.*: ([\w-]+)\]\((gallery/[\w-]+\.png)\)")


def verdict(section: str, folder: Path) -> str:
    """Return the verdict that the last command of a section prints; its figures go into ``folder/figures``."""
    for name, content in _CELL.findall(section):
        (folder / name).write_text(content, encoding="utf-8")
    printed = ""
    for line in _COMMANDS.findall(section)[0].splitlines():
        words = [*shlex.split(line), "--force"]
        if words[1] == "calibrate":
            words += ["--figures", "figures"]
        done = subprocess.run(
            [sys.executable, "-m", *words], cwd=folder, capture_output=True, text=True, timeout=300
        )
        printed = done.stdout
    return printed.split("\n\n")[1] + "\n"


def main() -> None:
    """Run all sections in one folder, and write the page and its figures."""
    page = DOCS / "gallery.md"
    head, *sections = page.read_text(encoding="utf-8").split("\n## ")
    done = [head]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for section in sections:
            printed = verdict(section, folder)
            for kind, file in _FIGURE.findall(section):
                shutil.copyfile(folder / "figures" / f"{kind}.png", DOCS / file)
            done.append(_VERDICT.sub(lambda _, text=printed: text, section))  # type: ignore[misc]
            print(f"{section.splitlines()[0]}: {printed.splitlines()[0]}")
    page.write_text("\n## ".join(done), encoding="utf-8")


if __name__ == "__main__":
    main()
