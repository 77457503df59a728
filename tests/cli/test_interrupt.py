"""Ctrl-C ends the program soon, also if a library swallows it."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

from calib.cli.exit_status import ExitStatus
from calib.cli.interrupt import INTERRUPTED

PROGRAM = """
import time
import calib.cli.interrupt as interrupt
interrupt._GRACE = {grace}
with interrupt.ends_after_ctrl_c():
    {work}
{after}
print("end")
"""

DEAF = """
    while True:
        try:
            print("ready", flush=True)
            time.sleep(60)
        except KeyboardInterrupt:
            pass
"""

WORKING = """
    try:
        print("ready", flush=True)
        time.sleep(60)
    except KeyboardInterrupt:
        print("heard", flush=True)
"""


def interrupted(work: str, grace: float, times: int = 1, after: str = "") -> tuple[int, str, str]:
    """Exit status and output of a program that gets Ctrl-C while it works."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(work=work.strip(), grace=grace, after=after)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8",
    )  # fmt: skip
    out = ""
    for _ in range(times):
        out += process.stdout.readline()
        process.send_signal(signal.SIGINT)
    more, err = process.communicate(timeout=20)
    return process.returncode, out + more, err


def test_work_that_swallows_it_is_ended():
    code, out, err = interrupted(DEAF, grace=0.1)
    assert (code, out) == (ExitStatus.INTERRUPTED, "ready\nready\n")
    assert err == f"{INTERRUPTED}\n"


def test_the_second_one_ends_at_once():
    begin = time.monotonic()
    code, _, err = interrupted(DEAF, grace=60.0, times=2)
    assert (code, err) == (ExitStatus.INTERRUPTED, f"{INTERRUPTED}\n")
    assert time.monotonic() - begin < 20.0


def test_work_that_ends_by_itself_is_let_end():
    code, out, err = interrupted(WORKING, grace=0.1, after="time.sleep(0.3)")
    assert (code, out, err) == (0, "ready\nheard\nend\n", "")


def test_a_program_that_ends_by_itself_may_take_its_time():
    begin = "with interrupt.left_to_the_program():\n        "
    work = begin + WORKING.strip().replace("\n", "\n    ") + "\n        time.sleep(0.3)"
    assert interrupted(work, grace=0.1) == (0, "ready\nheard\nend\n", "")


@pytest.mark.slow
@pytest.mark.parametrize("at", [0.2, 0.4, 0.8, 1.6])
@pytest.mark.parametrize(
    "words",
    [
        ("plan", "ur3", "--tip", "tool0", "-o", "plan.csv"),
        ("workspace", "ur3", "--tip", "tool0", "--samples", "3000000", "-o", "region.json"),
        ("simulate", "ur3", "--tip", "tool0", "--count", "200000", "-o", "table.csv"),
        ("fleet", "fleet.csv", "--out", "results", "--base", "base"),
    ],
    ids=lambda words: words[0],
)
def test_every_verb_ends_soon_and_leaves_no_file(program, shop, words, at):
    """Within 2 s on a busy machine; a process that is alone needs a second at most."""
    rows = "".join(f"{name},robot.urdf,data.csv\n" for name in "abcdefgh")
    (shop / "fleet.csv").write_text("name,robot,data\n" + rows)
    before = {path for path in shop.rglob("*") if path.is_file()}
    process = subprocess.Popen(
        [*program, *words], cwd=shop, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        encoding="utf-8", start_new_session=True,
    )  # fmt: skip
    time.sleep(at)
    process.send_signal(signal.SIGINT)
    begin = time.monotonic()
    _, err = process.communicate(timeout=20)
    assert time.monotonic() - begin < 2.0
    # Python ends itself by the signal if it came while a library compiled a text; a shell calls both 130.
    assert process.returncode in (ExitStatus.INTERRUPTED, -signal.SIGINT)
    assert err.startswith(INTERRUPTED)
    left = {path for path in shop.rglob("*") if path.is_file()} - before
    assert not [path for path in left if path.suffix in (".csv", ".json", ".tmp")]
