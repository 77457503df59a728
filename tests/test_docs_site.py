"""The pages of docs/: all listed, links that lead somewhere, calls and Python that run, messages that calib says.

The site itself is built by `make docs`, where a name that leads nowhere is an error too.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import shlex
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import typer
from markdown_it import MarkdownIt
from markdown_it.token import Token
from typer.main import get_command

import calib
from calib.example import paper_measurements, paper_urdf
from calib.program import app
from tests.cli_fixtures import calib_here
from tests.places import ROOT

DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted(DOCS.glob("*.md"))]
READER = MarkdownIt().enable("table")
ENTRY = re.compile(r"^ {3}([\w-]+)$", re.MULTILINE)


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


@cache
def tokens(page: Path) -> list[Token]:
    return READER.parse(page.read_text(encoding="utf-8"))


@cache
def anchors(page: Path) -> set[str]:
    """The anchors that hosts of Git repositories give to a page's headings."""
    found: set[str] = set()
    parsed = tokens(page)
    for token, inner in pairwise(parsed):
        if token.type == "heading_open":
            text = "".join(child.content for child in inner.children or ())
            slug = re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", "-")
            count = sum(slug == one or one.startswith(f"{slug}-") for one in found)
            found.add(f"{slug}-{count}" if slug in found else slug)
    return found


def links(page: Path) -> Iterator[str]:
    for token in tokens(page):
        for child in token.children or ():
            target = child.attrGet("href") or child.attrGet("src")
            if target:
                yield str(target)


def fences(page: Path) -> list[tuple[str, str]]:
    return [(token.info, token.content) for token in tokens(page) if token.type == "fence"]


def test_every_page_stands_in_one_list_of_contents():
    index = (DOCS / "index.rst").read_text(encoding="utf-8")
    named = ENTRY.findall(index)
    pages = {path.stem for path in (*DOCS.glob("*.md"), *DOCS.glob("*.rst"))} - {"index"}
    assert len(named) == len(set(named))
    assert set(named) <= pages
    # A page that is named nowhere appears under the last heading: conf.py fills it in.
    assert index.rstrip().endswith(".. unlisted")
    assert pages - set(named) <= {path.stem for path in DOCS.glob("*.md")}


def test_the_cards_lead_to_pages_with_a_command_on_the_first_screen():
    index = (DOCS / "index.rst").read_text(encoding="utf-8")
    cards = re.findall(r"grid-item-card:: .+\n +:link: ([\w-]+)\n", index)
    assert len(cards) == 11
    for card in cards:
        lines = (DOCS / f"{card}.md").read_text(encoding="utf-8").splitlines()
        first = next(n for n, line in enumerate(lines) if re.match(r"(calib|make|pip) \w", line))
        assert first < 30, card


def test_links_anchors_and_named_files_lead_somewhere():
    for page in PAGES:
        for target in links(page):
            if re.match(r"\w+:", target):
                continue
            file, _, anchor = target.partition("#")
            there = (page.parent / file).resolve() if file else page
            assert there.exists(), f"{page.name}: {target}"
            assert not anchor or anchor in anchors(there), f"{page.name}: {target}"
        if page.name == "CHANGELOG.md":
            continue  # which tells of files that went
        folders = r"(?<![\w/.])(?:calib|docs|scripts|tests|urdf)/[\w/-]+(?:\.\w+)+"
        for file in re.findall(folders, page.read_text(encoding="utf-8")):
            assert (ROOT / file).exists(), f"{page.name}: {file}"


def test_the_api_page_has_every_public_name_once():
    page = (DOCS / "api.rst").read_text(encoding="utf-8")
    listed = re.findall(r"^\.\. auto\w+:: calib\.(\w+)$", page, re.MULTILINE)
    modules = re.findall(r"^\* - ``calib\.(\w+)``$", page.replace("   ", ""), re.MULTILINE)
    assert sorted([*listed, *modules]) == calib.__all__


@pytest.mark.parametrize("page", ["api.rst", "api-parts.rst"])
def test_what_the_api_pages_describe_exists_and_has_its_fields_described(page: str):
    entries = re.findall(
        r"^\.\. auto\w+:: ([\w.]+)$", (DOCS / page).read_text("utf-8"), re.MULTILINE
    )
    assert len(entries) > 10
    for entry in entries:
        module, _, last = entry.rpartition(".")
        thing = getattr(importlib.import_module(module), last)
        assert thing.__doc__
        # What lies inside a result may say all of itself in a line.
        if page == "api.rst" and dataclasses.is_dataclass(thing) and isinstance(thing, type):
            # In the docstring, or in a comment for autodoc above or behind the field.
            bases = thing.__mro__[:-1]
            said = "".join(base.__doc__ or "" for base in bases)
            source = "".join(inspect.getsource(base) for base in bases)
            for field in dataclasses.fields(thing):
                name = field.name
                described = re.search(rf"^ +{name}:", said, re.MULTILINE) or re.search(
                    rf"^ +{name}: .*#: |#: .*\n +{name}: ", source, re.MULTILINE
                )
                assert described or name.startswith("_"), f"{entry}.{name}"


def test_docstrings_name_pages_that_exist():
    for path in (ROOT / "calib").rglob("*.py"):
        for page in re.findall(r"\bdocs/[\w-]+\.md", path.read_text(encoding="utf-8")):
            assert (ROOT / page).exists(), f"{path}: {page}"


# --- calls of the program -------------------------------------------------------------------------------------------

COMMAND = get_command(app)

#: What the program's parser raises, in every version of typer.
UsageError = typer.BadParameter.__bases__[0]


def blocks(page: Path) -> Iterator[str]:
    """Calls of calib that stand in blocks, a line each."""
    for info, content in fences(page):
        if info in {"sh", "text", ""}:
            for line in content.replace("\\\n", " ").splitlines():
                # What stands behind three blanks in a list of calls is a remark.
                yield re.split(r"(?<=\S) {3,}(?=[a-z])", line.strip())[0]


def spans(page: Path) -> Iterator[str]:
    """Calls of calib within the text, which may have an option's name without its value."""
    for token in tokens(page):
        yield from (c.content for c in token.children or () if c.type == "code_inline")


def is_call(text: str) -> bool:
    return bool(re.match(r"calib [a-z-]+( |$)", text))


def parse(call: str) -> None:
    """Parse a call as the program does; one that is broken off, or has words in capitals, by its options' names.

    Raises:
        UsageError: There is no such verb or option, or a value is none that it takes.
    """
    verb, *words = call.replace('"', " ").split()[1:]
    if verb == "help":
        verb, *words = [*words, "calibrate"]
    if verb.startswith("-"):
        if verb not in {"-h", "--help"}.union(*(p.opts for p in COMMAND.params)):
            message = f"there is no option '{verb}'"
            raise UsageError(message)
        return
    command = COMMAND.commands.get(verb)  # type: ignore[attr-defined]
    if command is None:
        message = f"there is no verb '{verb}'"
        raise UsageError(message)
    known = {"--help"}.union(*(p.opts + p.secondary_opts for p in command.params))
    for word in words:
        if word.startswith("--") and word not in known:
            message = f"there is no option '{word}'"
            raise UsageError(message)


def parse_whole(call: str) -> None:
    parse(call)
    words = shlex.split(call, comments=True)
    if words[1].startswith("-"):
        return
    if not any(word == "..." or word.isupper() for word in words):
        COMMAND.commands[words[1]].make_context(call, words[2:])  # type: ignore[attr-defined]


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_calls_of_the_program_are_such(page: Path):
    for call in filter(is_call, spans(page)):
        if call != "calib help VERB":
            parse(call)
    for call in filter(is_call, blocks(page)):
        parse_whole(call)


def test_calls_that_are_none_are_seen():
    parse_whole('calib calibrate robot.urdf data.csv --target "0 0 1 mm"')
    parse_whole("calib calibrate ... --frame estimate")
    parse("calib plan --region")
    parse("calib help board")
    parse("calib --show-completion")
    for wrong in (
        "calib fat robot.urdf",
        "calib --nonsense",
        "calib calibrate robot.urdf",
        "calib calibrate robot.urdf data.csv --nonsense",
        "calib calibrate ... --nonsense",
        "calib calibrate robot.urdf data.csv --priors best",
    ):
        with pytest.raises(UsageError):
            parse_whole(wrong)


# --- Python ---------------------------------------------------------------------------------------------------------

#: Pages whose Python is run by the tests of what it shows.
ELSEWHERE = {
    "README.md": "tests/test_readme.py",
    "planning.md": "tests/test_readme.py",
    "simulation.md": "tests/test_readme.py",
    "compensation.md": "tests/verbs/compensate/test_command.py",
    "programs.md": "tests/verbs/compensate/programs/test_program_output.py",
    "universal-robots.md": "tests/verbs/convert/test_ur_formats.py",
    "extending.md": "tests/test_extending.py",
    "data-format.md": "tests/data/test_covariances.py",
}

#: Run here, in this order: what one makes, the next may use.
HERE = (
    "quick-start.md",
    "result-json.md",
    "acceptance.md",
    "uncertainty.md",
    "certificate.md",
    "convert.md",
    "zeros.md",
    "workspace.md",
    "view.md",
    "dh-rows.md",
    "sessions.md",
)

#: What they show takes long and is run by other tests, in smaller ways: here their calls are held to what is called.
CALLED = ("check.md", "fleet.md", "report.md", "ros.md")


def python(page: str) -> str:
    return "\n".join(content for info, content in fences(DOCS / page) if info == "python")


def test_the_python_of_every_page_is_run():
    with_python = {page.name for page in PAGES if any(info == "python" for info, _ in fences(page))}
    new = with_python - {*ELSEWHERE, *HERE, *CALLED}
    assert not new, "run it here, or name the page in ELSEWHERE or CALLED"
    for page, tests in ELSEWHERE.items():
        assert page in (ROOT / tests).read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_python_of_these_pages_runs(tmp_path, monkeypatch, capsys):
    for file, given in {
        "robot.urdf": paper_urdf(),
        "corrected.urdf": ROOT / "urdf" / "ur3_calibrated.urdf",
        "data.csv": paper_measurements(),
        "fresh.csv": paper_measurements(),
    }.items():
        (tmp_path / file).symlink_to(given)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    calib_here(
        monkeypatch, tmp_path, "workspace", "robot.urdf", "--samples", "65536", "-o", "region.json"
    )
    for page in HERE:
        (tmp_path / "result.json").unlink(missing_ok=True)
        if page in ("result-json.md", "uncertainty.md"):
            names["result"].write_json("result.json")
        exec(compile(python(page), page, "exec"), names)
        assert capsys.readouterr().out or page in ("convert.md", "result-json.md", "dh-rows.md")
        names.update(calibration=names["result"], q=np.zeros(6))
    made = {path.name for path in tmp_path.iterdir() if not path.is_symlink()}
    assert {"from_python.urdf", "rows.csv"} <= made


@pytest.mark.parametrize("page", CALLED)
def test_the_calls_of_these_pages_fit_what_is_called(page: str):
    tree = ast.parse(python(page))
    names: dict[str, object] = {"calib": calib, "calibration": calib.Calibration}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            exec(compile(ast.unparse(node), page, "exec"), names)
    bound = 0
    for node in ast.walk(tree):
        called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
        if called.split(".")[0] in names:
            method = called.startswith("calibration.")  # of the class, which takes a self
            signature = inspect.signature(eval(called, names))
            signature.bind(*node.args, *[None] * method, **{k.arg or "": k for k in node.keywords})
            bound += 1
    assert bound


def test_every_claim_of_the_theory_has_its_source_and_every_source_its_claim():
    text, _, table = (DOCS / "theory.md").read_text(encoding="utf-8").partition("## Sources")
    sources = set(re.findall(r"^\| (\w+ [\d-]+) \|", table, re.MULTILINE))
    cited = re.findall(r"\[((?:\w+ [\d-]{4,}(?:, )?)+)\](?!\()", " ".join(text.split()))
    assert len(sources) > 30
    assert {one for group in cited for one in group.split(", ")} == sources
