"""What holds for all verbs: start-up, wrong calls, pipes, interrupts, and that the document tells the truth."""

from __future__ import annotations

import os
import pty
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.data.measurements import Measurements
from calib.program import VERBS
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.places import ROOT

DOC = ROOT / "docs" / "command-line.md"
HEAVY = ("numpy", "scipy", "pinocchio", "meshcat", "yourdfpy", "rich.progress")

#: What a table's command does without: pictures, pages, meshes, SciPy's distributions and searches.
OF_OTHERS = (
    "cv2", "jinja2", "matplotlib", "meshcat", "networkx", "openpyxl", "PIL", "scipy.ndimage", "scipy.optimize",
    "scipy.stats", "trimesh", "xacro", "yourdfpy",
)  # fmt: skip

WATCHED = f"""
import atexit, os, sys
heavy = {HEAVY + OF_OTHERS!r}
atexit.register(lambda: os.write(2, " ".join(name for name in heavy if name in sys.modules).encode()))
from calib.__main__ import main
sys.argv[0] = "calib"
main()
"""


def imported(folder: Path, *words: str) -> list[str]:
    """Which heavy modules a call has imported by its end."""
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, *words],
        cwd=folder, capture_output=True, encoding="utf-8", check=True,
    )  # fmt: skip
    return done.stderr.split()


@pytest.mark.parametrize("words", [("--help",), ("demo", "--help")])
def test_the_start_loads_nothing_heavy(tmp_path: Path, words: tuple[str, ...]):
    """Only the help of a verb that lists what is registered reads the registries."""
    assert imported(tmp_path, *words) == []


OF_TABLES = {
    "calibrate": "robot.urdf data.csv --base base --model dh -o c.urdf --json r.json",
    "evaluate": "robot.urdf data.csv --base base",
    "inspect": "robot.urdf data.csv --base base",
    "compare": "result.json result.json",
    "compensate": "robot.urdf joints.csv --calibration result.json -o commands.csv --accept --skip",
    "convert": "result.json --to dh -o rows.csv --accept",
    "simulate": "robot.urdf --base base -o table.csv",
}


@pytest.mark.slow
@pytest.mark.parametrize("verb", OF_TABLES)
def test_a_command_of_tables_loads_nothing_for_pages_and_pictures(shop: Path, run, verb: str):
    made = run(
        shop,
        "fit",
        *["robot.urdf", "data.csv", "--base", "base", "--json", "result.json", "--no-validate"],
    )
    assert made.code == 0
    loaded = imported(shop, verb, *OF_TABLES[verb].split())
    assert set(loaded) & set(OF_OTHERS) == set()


def test_a_calibration_loads_nothing_for_pages_and_pictures(shop: Path):
    """The quickest call that fits and writes, in every run of the tests."""
    words = "robot.urdf data.csv --base base --model zeros --no-validate -o c.urdf --quiet"
    loaded = imported(shop, "fit", *words.split())
    assert "scipy" in loaded
    assert set(loaded) & set(OF_OTHERS) == set()


def test_a_wrong_call_of_the_program_itself(run, tmp_path: Path):
    done = run(tmp_path, "fat")
    assert (done.code, done.out) == (2, "")
    assert done.err.splitlines()[-1] == "Error: No such command 'fat'. Did you mean 'fit'?"


@pytest.mark.slow
def test_version_and_help(run, tmp_path: Path):
    assert run(tmp_path, "--version").out == f"calib {calib.__version__}\n"
    done = run(tmp_path, "--help")
    assert done.code == 0
    for verb in ("demo", "calibrate", "evaluate", "inspect"):
        assert re.search(rf"\n  {verb} +[A-Z]", done.out)


@pytest.mark.slow
def test_the_help_is_whole_in_80_columns_and_in_the_order_of_the_work(run, tmp_path: Path):
    done = run(tmp_path, "-h")
    assert done.code == 0
    assert done.out == run(tmp_path, "help").out == run(tmp_path, "--help").out
    assert "..." not in done.out.replace("[ARGS]...", "")
    assert max(map(len, done.lines)) <= 80
    listed = re.findall(r"(?m)^  ([a-z][a-z-]+)  +[A-Z]", done.out)
    assert listed == list(VERBS)
    order = ("inspect", "plan", "calibrate", "evaluate", "compensate")
    assert sorted(order, key=listed.index) == list(order)
    assert run(tmp_path, "-V").out == run(tmp_path, "--version").out
    asked = [("board", "-h"), ("board", "--help"), ("help", "board"), ("board", "help")]
    answers = {run(tmp_path, *words).out for words in asked}
    assert len(answers) == 1
    assert "Usage: calib board" in answers.pop()


@pytest.mark.parametrize(
    ("word", "verb"),
    [("calibrat", "calibrate"), ("validate", "evaluate"), ("export", "convert"), ("show", "view")],
)
def test_a_word_of_another_program_names_the_verb(call, tmp_path: Path, word: str, verb: str):
    done = call(tmp_path, word, "robot.urdf")
    assert (done.code, done.out) == (2, "")
    assert done.err.splitlines()[-1] == f"Error: No such command '{word}'. Did you mean '{verb}'?"


#: Words before the cursor, and what a shell proposes.
COMPLETED = {
    "calib ca": ["calibrate"],
    "calib ": list(VERBS),
    "calib --ver": ["--version"],
    "calib evaluate robot.urdf data.csv --tol": ["--tolerance"],
    "calib calibrate robot.urdf --figure-format p": ["png", "pdf"],
    "calib calibrate rob": [],  # a shell then proposes files
    "calib calibrate robot.urdf data.csv --json ": [],
}


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes_verbs_options_and_choices(program, tmp_path: Path):
    """By the function that ``--show-completion`` prints, in a bash that was started for it."""
    starter = tmp_path / "calib"
    starter.write_text(f'#!/bin/sh\nexec {shlex.join(program)} "$@"\n')
    starter.chmod(0o755)
    script = ['eval "$(calib --show-completion)"', "complete -p calib"]
    for line in COMPLETED:
        words = line.split(" ")
        script.append(f"COMP_WORDS=({' '.join(repr(word) for word in words)})")
        script.append(f"COMP_CWORD={len(words) - 1}")
        script.append('_calib_completion calib; echo "${COMPREPLY[*]}"')
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "COLUMNS": "40"}
    # A line more keeps bash from becoming the program: completion asks which shell has started it.
    done = subprocess.run(
        ["bash", "--norc", "-c", "\n".join([*script, "true"])],
        cwd=tmp_path, env=environment, capture_output=True, encoding="utf-8", check=True,
    )  # fmt: skip
    assert done.stderr == ""
    registered, *proposed = done.stdout.splitlines()
    assert registered == "complete -o default -F _calib_completion calib"
    assert [line.split() for line in proposed] == list(COMPLETED.values())


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("fat",),
        ("fit",),
        ("fit", "robot.urdf"),
        ("fit", "robot.urdf", "data.csv", "--nonsense"),
        ("fit", "robot.urdf", "data.csv", "--priors", "best"),
        ("fit", "robot.urdf", "data.csv", "--bootstrap", "39"),
        ("demo", "folder"),
    ],
)
def test_a_wrong_call_exits_2(call, tmp_path: Path, words: tuple[str, ...]):
    done = call(tmp_path, *words)
    assert done.code == 2
    assert "Usage: calib" in done.out + done.err or "Error: " in done.err
    assert list(tmp_path.iterdir()) == []


def test_every_example_of_the_document_works(examples):
    assert len(examples.done) >= 10
    for call, done in examples.done.items():
        assert (done.code, done.err) == (0, ""), call
    made = {path.name for path in examples.folder.iterdir()}
    assert {
        "corrected.urdf",
        "result.json",
        "report.html",
        "plan.csv",
        "results",
        "rows.csv",
    } <= made


def test_the_printed_text_is_plain_and_fits_100_columns(examples):
    for call, done in examples.done.items():
        assert all(line.isprintable() for line in done.lines), call
        assert all(line == line.rstrip() for line in done.lines), call
        assert max(map(len, done.lines), default=0) <= 100, call


@pytest.mark.slow
def test_a_reader_that_goes_away_does_not_cost_the_files(program, shop: Path):
    words = ("fit", "robot.urdf", "data.csv", "--base", "base", "--no-validate")
    words = (*words, "-o", "c.urdf", "--json", "r.json")
    assert closed_pipe(program, shop, *words) == (0, "")
    assert (shop / "c.urdf").is_file()
    assert (shop / "r.json").is_file()


@pytest.mark.slow
def test_a_program_that_is_started_without_stdout_and_stderr(program, shop: Path):
    call = ["sh", "-c", 'exec "$@" >&- 2>&-', "sh", *program]
    words = ("fit", "robot.urdf", "data.csv", "--base", "base", "--no-validate", "-o", "c.urdf")
    assert subprocess.run([*call, *words], cwd=shop).returncode == 0
    assert (shop / "c.urdf").read_bytes().startswith((shop / "robot.urdf").read_bytes()[:20])


def closed_pipe(program: list[str], folder: Path, *words: str) -> tuple[int, str]:
    """Run with a stdout whose reader has gone; exit code and stderr."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [*program, *words],
        cwd=folder, stdout=writer, stderr=subprocess.PIPE, encoding="utf-8", check=False,
    )  # fmt: skip
    os.close(writer)
    return done.returncode, done.stderr


@pytest.fixture
def long_work(shop: Path) -> list[str]:
    """A call that computes for much longer than a test may take."""
    robot = Robot.load(shop / "robot.urdf", "base", "tool0")
    q = random_joint_values(robot, 100_000)
    poses = robot.poses(q)
    rng = np.random.default_rng(1)
    points = poses[:, :3, :3] @ [0.05, 0.06, 0.07] + poses[:, :3, 3]
    points += rng.normal(0.0, 1e-4, points.shape)
    Measurements(robot.joint_names, q, points).write(shop / "many.csv")
    return [
        "fit", "robot.urdf", "many.csv", "--base", "base", "--model", "placement",
        "--frame", "estimate", "-o", "c.urdf", "--json", "r.json",
    ]  # fmt: skip


@pytest.mark.slow
def test_ctrl_c_leaves_no_file(program, shop: Path, long_work: list[str]):
    before = set(shop.iterdir())
    process = subprocess.Popen(
        [*program, *long_work],
        cwd=shop, stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8",
    )  # fmt: skip
    time.sleep(3.0)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, "")
    assert err == "calib: interrupted; no file was left half written.\n"
    assert set(shop.iterdir()) == before


def test_ctrl_c_while_a_verb_is_imported_says_the_same(program, tmp_path: Path):
    # A plugin is loaded after the options before the verb are read, and before those of the verb are.
    plugin = tmp_path / "interrupted.py"
    plugin.write_text("exec('raise KeyboardInterrupt')\n")
    words = ("calibrate", "robot.urdf", "data.csv", "--plugin", str(plugin))
    done = subprocess.run(
        [*program, *words], cwd=tmp_path, capture_output=True, encoding="utf-8", check=False
    )
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "calib: interrupted; no file was left half written.\n"


@pytest.mark.slow
def test_a_terminal_sees_progress_and_a_pipe_does_not(program, shop: Path):
    terminal, theirs = pty.openpty()
    process = subprocess.Popen(
        [
            *program, "fit", "robot.urdf", "data.csv", "--base", "base", "--model", "zeros",
            "--bootstrap", "200",
        ],
        cwd=shop, stdout=subprocess.PIPE, stderr=theirs, encoding="utf-8",
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
    )  # fmt: skip
    os.close(theirs)
    seen = b""
    while True:
        try:
            piece = os.read(terminal, 65536)
        except OSError:  # Linux's way to say that the other side has closed
            break
        if not piece:
            break
        seen += piece
    out, _ = process.communicate(timeout=60)
    os.close(terminal)
    assert process.returncode == 0
    assert b"cross-validation" in seen
    assert b"bootstrap" in seen
    assert "\x1b" not in out
    assert "Verdict: use" in out
