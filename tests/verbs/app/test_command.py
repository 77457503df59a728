"""``calib app`` as it is typed: its own process, its address, Ctrl-C, and what it needs."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.cli_fixtures import PROGRAM, calib
from tests.verbs.app.measured import begun, operator, shown_pose, typed
from tests.verbs.app.served import Client

pytestmark = pytest.mark.slow


@contextmanager
def started(folder: Path, *words: str) -> Iterator[tuple[subprocess.Popen[str], Client]]:
    """The program, and a client of the address that it prints."""
    command = [*PROGRAM, "app", str(folder), "--no-browser", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.fullmatch(r"calib app: http://127\.0\.0\.1:(\d+)/\?token=(\S+)\n", line)
        assert found is not None, line
        yield process, Client(int(found[1]), found[2], folder)
    finally:
        process.kill()
        process.communicate()


def stop(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Press Ctrl-C; the exit status and what was printed on stderr."""
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=15)
    return process.returncode, err


def test_it_serves_until_ctrl_c_and_goes_on_at_the_next_start(tmp_path: Path):
    folder = tmp_path / "desk"
    with started(folder, "--port", "0") as (process, client):
        job = client.enter().post("/example", key="1").to
        code, err = stop(process)
    assert code == 0
    assert "Traceback" not in err
    port = client.port
    with started(folder, "--port", str(port)) as (process, again):
        assert again.token == client.token  # so that open pages go on
        assert client.get(job).status == 200
        stop(process)


def test_a_run_ends_with_the_server_and_says_so(tmp_path: Path):
    with started(tmp_path, "--port", "0") as (process, client):
        job = client.enter().post("/example", key="1").to
        client.post(f"{job}/choose", action="calibrate")
        assert client.get(f"{job}/progress").headers["x-state"] == "running"
        began = time.monotonic()
        code, _ = stop(process)
        assert code == 0
        assert time.monotonic() - began < 8.0
    with started(tmp_path, "--port", "0") as (_, client):
        client.enter()
        assert client.get(f"{job}/progress").headers["x-state"] == "interrupted"
        assert "Interrupted" in client.get(job).text


def test_a_run_outlives_a_server_that_is_killed(tmp_path: Path):
    with started(tmp_path, "--port", "0") as (process, client):
        job = client.enter().post("/example", key="1").to
        client.post(f"{job}/choose", action="calibrate")
        process.kill()
        process.wait()
    with started(tmp_path, "--port", "0") as (_, client):
        assert client.enter().wait(job) == "done"
        assert "corrected.urdf" in client.get(job).text


def test_a_server_killed_in_a_session_loses_and_doubles_nothing(tmp_path: Path):
    """Killed at ten moments while a reading is sent, and the same form is sent again after each start."""
    person = operator()
    rng = np.random.default_rng(1)
    sent: dict[str, str] = {}
    job, answered = "", set()
    for kill in range(11):
        with started(tmp_path, "--port", "0") as (process, client):
            client.enter()
            job = job or begun(client)
            if sent:  # the reading that was under way when the server was killed
                client.form(f"{job}/reading", sent)
            if kill == 10:
                break
            page = client.get(job)
            reading = person.measure(shown_pose(page), again="Again: stop" in page.text).readings
            sent = typed(reading.points[0], page)
            killer = threading.Timer(float(rng.uniform(0.0, 0.12)), process.kill)
            killer.start()
            with contextlib.suppress(OSError, http.client.HTTPException):
                if client.form(f"{job}/reading", sent).status == 303:
                    answered.add(sent["key"])
            killer.join()
    journal = tmp_path / job[6:] / "session" / "journal.jsonl"
    events = [json.loads(line) for line in journal.read_text().splitlines()]
    keys = [event["key"] for event in events if event["event"] == "row"]
    assert len(keys) == len(set(keys)) == 10
    assert answered <= set(keys)


def test_it_listens_on_loopback_alone(tmp_path: Path):
    with started(tmp_path, "--port", "0") as (_, client):
        name = socket.gethostbyname(socket.gethostname())
        if not name.startswith("127."):
            with pytest.raises(ConnectionError), socket.create_connection((name, client.port), 2):
                pass


def test_a_port_that_is_taken(tmp_path: Path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        done = calib(tmp_path, "app", "desk", "--no-browser", "--port", str(other.getsockname()[1]))
    assert done.code == 1
    assert "--port" in done.err
    assert "Traceback" not in done.err


def test_a_folder_that_is_a_file_and_a_language_that_is_not_there(tmp_path: Path):
    (tmp_path / "desk").write_text("")
    done = calib(tmp_path, "app", "desk", "--no-browser")
    assert done.code == 1
    assert "desk" in done.err
    done = calib(tmp_path, "app", "--no-browser", "--language", "tlh")
    assert done.code == 1
    assert "'en', 'de'" in done.err


def test_without_the_extra_it_says_what_to_install(tmp_path: Path):
    code = (
        "import sys\n"
        "class Hidden:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'uvicorn': raise ModuleNotFoundError(name, name=name)\n"
        "sys.meta_path.insert(0, Hidden())\n"
        "sys.argv = ['calib', 'app']\n"
        "from calib.__main__ import main; main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "robot-calib[app]" in done.stderr
