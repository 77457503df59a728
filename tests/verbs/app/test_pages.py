"""The pages through HTTP: from files to the verdict, what is refused in words, and what a reload does."""

from __future__ import annotations

import json
import re
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from calib.example import paper_measurements, paper_urdf
from calib.result.calibration import Calibration
from calib.verbs.app.runs import MOST_RUNS
from tests.verbs.app.sent import ROWS, TABLE, URDF
from tests.verbs.app.served import Client, served
from tests.verbs.check.shop import POSES, paper_result, points, write_rows

SCRIPT = '<script>alert("1")</script>'


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A client of a folder with one result, of a robot with a serial number."""
    folder = tmp_path_factory.mktemp("shelf")
    with served(folder, "en") as client:
        client.enter()
        job = client.post("/example", key="k").to
        client.form(f"{job}/choose", {"action": "calibrate", "was:serial": "", "serial": SCRIPT})
        assert client.wait(job) == "done"
        yield client


JOB = "/jobs/0001-ur3-example"


def test_pages_lead_to_each_other(client: Client):
    assert client.get("/").to == "/open"
    for page in ("/open", "/check", "/history"):
        text = client.get(page).text
        assert f'<a href="{page}" aria-current="page">' in text
    assert client.get("/nowhere").status == 404
    assert client.get("/jobs/0009-x").status == 404


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [
        "..%2f..%2fetc%2fpasswd",
        "../../../etc/passwd",
        ".job.json",
        ".run/errors.txt",
        "%2e%2e/.token",
        "",
    ],
)
def test_only_files_that_the_job_knows_are_sent(shelf: Client, path: str):
    assert shelf.get(f"{JOB}/files/{path}").status in (404, 303, 307)
    assert shelf.get(f"/static/{path}").status == 404
    assert shelf.get(f"/history/{path}/result.json").status == 404
    assert shelf.get(f"/jobs/{path}/progress").status == 404


def test_a_link_in_the_folder_leads_nowhere(client: Client):
    """Names of jobs are those of folders with a job, whatever else is put there."""
    (client.folder / "etc").symlink_to("/etc")
    assert client.get("/jobs/etc").status == 404
    assert client.get("/jobs/etc/files/passwd").status == 404


@pytest.mark.slow
def test_from_files_to_the_verdict(shelf: Client):
    text = shelf.get(JOB).text
    assert "Verdict: use</h2>" in text
    assert "2.350 mm" in text
    assert "0.208 mm" in text
    result = Calibration.read_json(shelf.folder / JOB[6:] / "result.json")
    assert shelf.get(f"{JOB}/files/corrected.urdf").body == result.checked_urdf().data
    kinds = {
        name: shelf.get(f"{JOB}/files/{name}").headers
        for name in ("view.html", "report.html", "result.json", "ur3.urdf")
    }
    assert (
        kinds["view.html"]["content-security-policy"]
        == "sandbox allow-scripts; frame-ancestors 'self'"
    )
    assert kinds["report.html"]["content-security-policy"].startswith("sandbox;")
    for name in ("result.json", "ur3.urdf"):
        assert kinds[name]["content-disposition"].startswith("attachment")
        assert kinds[name]["content-type"] == "application/octet-stream"
    assert (
        "attachment"
        in shelf.get(f"{JOB}/files/view.html?download=1").headers["content-disposition"]
    )


@pytest.mark.slow
def test_names_are_shown_as_text(shelf: Client):
    for page in (JOB, "/history", "/check", "/open"):
        assert "<script>alert" not in shelf.get(page).body.decode()
    assert SCRIPT in shelf.get("/history").text  # as characters


@pytest.mark.parametrize("named", ["robot", "column", "file"])
def test_names_in_files_are_shown_as_text(client: Client, named: str):
    urdf, table, file = URDF, TABLE, "data.csv"
    if named == "robot":
        name = SCRIPT.replace("<", "&lt;").replace('"', "&quot;")
        urdf = re.sub(rb'<robot name="\w+"', f'<robot name="{name}"'.encode(), urdf, count=1)
    elif named == "column":
        table = table.replace("row,", f"{SCRIPT.replace(chr(34), chr(39))},", 1)
    else:
        file = "<img src=x onerror=alert(1)>.csv"
    job = client.open(("ur3.urdf", urdf), (file, table.encode()))
    page = client.get(job)
    assert page.status == 200
    assert b"<script>alert" not in page.body
    assert b"<img" not in page.body


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("ur3.urdf", b"<robot name='a'><link"),
        ("ur3.urdf", b"<robot name='a'/>"),
        ("ur3.urdf", b""),
        ("data.csv", b"a,b\n1\n"),
        ("data.csv", b"\xff\xfe\x00"),
        ("data.xlsx", b"PK\x03\x04"),
        ("cell.toml", b"base = 3"),
        ("board.yaml", b"a: [1"),
        ("robot.xacro", b"<robot xmlns:xacro='x'><xacro:if value='${1/0}'/></robot>"),
        ("result.json", b"{"),
        ("picture.png", b"\x89PNG no picture"),
    ],
)
def test_a_malformed_file_is_named_and_nothing_breaks(client: Client, name: str, content: bytes):
    files = {"ur3.urdf": URDF, "data.csv": TABLE.encode(), name: content}
    page = client.get(client.open(*files.items()))
    assert page.status == 200
    assert "Traceback" not in page.text
    assert str(client.folder) not in page.text.partition("<footer>")[0]


def test_a_robot_by_name_is_one_that_calib_knows(client: Client):
    for name in ("/etc/passwd", "../ur3.urdf", "ur33"):
        answer = client.upload("/open", [], robot_name=name)
        assert answer.status == 400
        assert "knows by its name" in answer.text
    assert client.upload("/open", [], robot_name="UR3").status == 303
    assert client.upload("/open", []).status == 400


def test_files_are_added_replaced_and_removed(client: Client):
    job = client.open(paper_urdf())
    assert "measurements are missing" in client.get(job).text
    client.upload(f"{job}/files", [("files", "data.csv", b"a\n1\n")])
    client.upload(f"{job}/files", [("files", "data.csv", TABLE.encode())])
    assert "35 measured rows" in client.get(job).text
    client.post(f"{job}/drop", name="data.csv")
    client.post(f"{job}/drop", name="../.token")
    assert "measurements are missing" in client.get(job).text
    assert (client.folder / ".token").is_file()


def test_choices_are_kept_where_they_differ_from_what_was_shown(client: Client):
    job = client.open(paper_urdf(), paper_measurements())
    fields = {
        "was:base": "base",
        "base": "base",
        "was:frame": "known",
        "frame": "estimate",
        "action": "look",
    }
    client.form(f"{job}/choose", fields)
    record = json.loads((client.folder / job[6:] / ".job.json").read_bytes())
    assert record["choices"] == {"frame": "estimate"}
    # Another robot, another base.
    client.form(f"{job}/choose", {"was:robot_name": "", "robot_name": "ur5", "action": "look"})
    record = json.loads((client.folder / job[6:] / ".job.json").read_bytes())
    assert record["choices"] == {"robot_name": "ur5"}
    text = client.get(job).text
    assert 'name="robot_name" value="ur5"' in text


def test_a_fault_keeps_it_from_being_started(client: Client):
    job = client.open(paper_urdf(), ("data.csv", TABLE.replace("elbow_joint", "elbow").encode()))
    client.post(f"{job}/choose", action="calibrate")
    answer = client.get(job)
    assert "cannot be read so" in answer.text
    assert not (client.folder / job[6:] / ".run").exists()


@pytest.mark.slow
def test_a_second_start_and_two_browsers_run_it_once(client: Client):
    job = client.open(paper_urdf(), paper_measurements())
    second = Client(client.port, client.token, client.folder).enter()
    starts = [
        threading.Thread(target=one.post, args=(f"{job}/choose",), kwargs={"action": "calibrate"})
        for one in (client, second) * 3
    ]
    for thread in starts:
        thread.start()
    for thread in starts:
        thread.join()
    assert "Calibrating" in second.get(job).text
    assert client.wait(job) == "done"
    client.post(f"{job}/choose", action="calibrate")
    assert client.wait(job) == "done"
    pages = [re.sub(r'name="key" value="\w+"', "", one.get(job).text) for one in (client, second)]
    assert pages[0] == pages[1]
    assert len(list(client.folder.glob("0*"))) == 1


@pytest.mark.slow
def test_progress_is_told_and_a_run_can_be_cancelled(client: Client):
    job = client.open(paper_urdf(), paper_measurements())
    client.post(f"{job}/choose", action="calibrate")
    seen: set[str] = set()
    while (answer := client.get(f"{job}/progress")).headers["x-state"] == "running":
        seen.update(
            re.findall(r'<li class="now">.*?<span class="what">([^<]+)', answer.text, re.DOTALL)
        )
        if "models" in seen:
            client.post(f"{job}/cancel")
    assert answer.headers["x-state"] == "cancelled"
    assert "reading" in seen
    assert "Cancelled" in client.get(job).text
    folder = client.folder / job[6:]
    left = {path.name for path in folder.iterdir()} - {".job.json", ".run"}
    assert left == {"ur3.urdf", "ur3_leica.csv", "cell.toml"}
    again = client.post(f"{job}/again", key="again").to
    assert client.post(f"{job}/again", key="again").to == again
    assert "35 measured rows" in client.get(again).text
    client.post(f"{job}/remove")
    assert client.get(job).status == 404
    assert client.get(again).status == 200


@pytest.mark.slow
def test_only_so_many_run_at_a_time(client: Client):
    jobs = [client.open(paper_urdf(), paper_measurements()) for _ in range(MOST_RUNS + 1)]
    answers = [client.post(f"{job}/choose", action="calibrate") for job in jobs]
    assert [answer.status for answer in answers] == [303] * MOST_RUNS + [400]
    assert "running already" in answers[-1].text
    for job in jobs[:-1]:
        client.post(f"{job}/cancel")
    assert client.post(f"{jobs[-1]}/choose", action="calibrate").status == 303
    assert client.get(f"{jobs[-1]}/progress").headers["x-state"] == "running"


@pytest.mark.slow
def test_the_robot_is_withheld_where_the_verdict_says_do_not_use(client: Client):
    rng = np.random.default_rng(1)
    rows = [[*row[:8], *map(str, rng.uniform(-500, 500, 3))] for row in ROWS[1:]]
    noise = "\n".join(map(",".join, [ROWS[0], *rows])).encode()
    job = client.open(paper_urdf(), ("data.csv", noise))
    client.form(f"{job}/choose", {"action": "calibrate", "was:frame": "estimate", "frame": "known"})
    assert client.wait(job) == "done"
    text = client.get(job).text
    assert "Verdict: do not use" in text
    assert "withheld" in text
    assert client.get(f"{job}/files/corrected.urdf").status == 404
    assert "corrected.urdf</a>" not in text


def test_a_run_that_ends_with_an_error_says_what_calib_said(client: Client):
    """Corners of a board beside no picture that shows one: calib detect finds none."""
    header = ",".join(["image", *ROWS[0][2:8]])
    board = (Path(__file__).parents[3] / "calib" / "example" / "franka" / "board.toml").read_bytes()
    job = client.open(
        paper_urdf(),
        ("joints.csv", f"{header}\n1.png,1,2,3,4,5,6\n".encode()),
        ("board.toml", board),
        ("1.png", b"\x89PNG no picture"),
    )
    client.form(f"{job}/choose", {"action": "calibrate", "was:camera": "", "camera": "640x480"})
    assert client.wait(job) == "failed"
    text = client.get(job).text
    assert "The calibration ended with a message" in text
    assert '<blockquote lang="en">calib: ' in text
    assert "Traceback" not in text


def test_languages_by_browser_option_and_switch(client: Client, tmp_path: Path):
    assert '<html lang="en"' in client.get("/open").text  # the option
    with served(tmp_path / "free") as free:
        free.enter()
        assert '<html lang="de"' in free.get("/open", **{"Accept-Language": "de-AT,en;q=0.8"}).text
        assert '<html lang="en"' in free.get("/open", **{"Accept-Language": "fr"}).text
        answer = free.post("/preferences", language="de", theme="dark", to="/history")
        assert answer.to == "/history"
        free.cookies |= {"calib_language": "de", "calib_theme": "dark"}
        assert '<html lang="de" data-theme="dark">' in free.get("/history").text
        free.cookies |= {"calib_language": "../x", "calib_theme": '"><script>'}
        assert '<html lang="en" data-theme="auto">' in free.get("/history").text
    for to in ("//example.org", "http://example.org", "/jobs/../../x/y", ""):
        assert client.post("/preferences", to=to).to in ("/open",)


@pytest.fixture
def checked(client: Client) -> Client:
    """A client of a folder with the paper's result."""
    paper_result().write_json(client.folder / "result.json")
    return client


def rows_of(table, tmp_path: Path) -> bytes:  # type: ignore[no-untyped-def]
    return write_rows(table, tmp_path / "rows.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("moved", "shade", "words"),
    [
        ({}, "good", "Nothing has moved."),
        ({"target": (0.004, 0.0, 0.0)}, "bad", "The target or its holder has moved."),
        ({"zeros": (0.0, 0.0, 0.01, 0.0, 0.0, 0.0)}, "bad", "Joint elbow_joint has moved."),
    ],
)
def test_a_check_of_this_morning_s_rows(
    checked: Client, tmp_path: Path, moved, shade: str, words: str
):  # type: ignore[no-untyped-def]
    page = checked.get("/check")
    rows = rows_of(points(POSES, **moved), tmp_path)
    fields = {"result": "result.json", "key": page.key(), "tolerance": "0.5 mm"}
    job = checked.upload("/check", [("files", "rows.csv", rows)], **fields).to
    assert checked.upload("/check", [("files", "rows.csv", rows)], **fields).to == job
    assert checked.wait(job) == "done"
    text = checked.get(job).text
    assert f'<section class="verdict {shade}"' in text
    assert words in text
    table = json.loads(checked.get(f"{job}/files/check.json").body)
    assert (table["outcome"] == "nothing") == (not moved)
    assert table["tolerance_m"] == 0.0005
    assert "Fewer than three poses" not in text
    box = text.partition('<section class="verdict')[2].partition("</section>")[0]
    elbow = next(one for one in table["noticed"] if one["name"] == "elbow_joint")
    assert f"elbow_joint: its zero by {np.rad2deg(elbow['turn_rad']):.3f} deg" in box
    assert box.count("<li>") + box.count(";") + box.count("every ") >= len(table["noticed"])
    checked.cookies["calib_language"] = "de"
    assert ("Nichts hat sich bewegt." in checked.get(job).text) == (not moved)


@pytest.mark.slow
def test_a_check_of_two_poses_warns(checked: Client, tmp_path: Path):
    rows = rows_of(points(POSES[:2]), tmp_path)
    fields = {"result": "result.json", "key": checked.get("/check").key()}
    job = checked.upload("/check", [("files", "rows.csv", rows)], **fields).to
    assert checked.wait(job) == "done"
    text = checked.get(job).text
    assert '<section class="verdict care"' in text
    assert "Fewer than three poses show little" in text
    assert "They cannot show" in text


@pytest.mark.slow
def test_poses_to_check_at_are_a_table(checked: Client):
    job = checked.post("/check/poses", result="result.json", count="3", key="p").to
    assert checked.wait(job) == "done"
    text = checked.get(job).text
    assert "elbow_joint [deg]" in text
    assert text.count("<tr>") == 4
    assert checked.get(f"{job}/files/poses.csv").body.count(b"\n") == 4


def test_a_check_that_cannot_begin_says_why(checked: Client, tmp_path: Path):
    rows = rows_of(points(POSES), tmp_path)
    for parts, fields in (
        ([], {"result": "result.json"}),
        ([("files", "rows.csv", rows)], {"result": "../result.json"}),
        ([("files", "rows.csv", rows)], {"result": "none.json"}),
        ([("files", "rows.csv", b"\xff\x00")], {"result": "result.json"}),
    ):
        answer = checked.upload("/check", parts, **fields)
        assert answer.status == 400
        assert '<blockquote lang="en">' in answer.text
    for count in ("0", "99", "three", "-1", "1e3"):
        assert checked.post("/check/poses", result="result.json", count=count).status == 400
    assert not list(checked.folder.glob("0*"))


@pytest.mark.slow
def test_the_history_shows_which_one_is_valid(shelf: Client):
    text = shelf.get("/history").text
    run = Calibration.read_json(shelf.folder / JOB[6:] / "result.json").run
    assert f"valid: {run}" in text
    urdf = shelf.get(f"/history/{run}/corrected.urdf")
    assert urdf.body == shelf.get(f"{JOB}/files/corrected.urdf").body
    assert json.loads(shelf.get(f"/history/{run}/result.json").body)["run"] == run
    assert shelf.get(f"/history/{run}/other").status == 404
    assert shelf.get("/history/000000000000/result.json").status == 404


def test_results_without_a_serial_number_are_listed_too(checked: Client):
    text = checked.get("/history").text
    assert "Calibrations without a serial number" in text
    assert "result.json" in text
    (checked.folder / "damaged").mkdir()
    (checked.folder / "damaged" / "result.json").write_bytes(
        (checked.folder / "result.json").read_bytes()[:500] + b"}"
    )
    assert checked.get("/history").status == 200
    assert checked.get("/check").status == 200


def test_a_damaged_job_is_left_out(client: Client):
    job = client.open(paper_urdf())
    (client.folder / job[6:] / ".job.json").write_text("{")
    assert client.get("/open").status == 200
    assert client.get(job).status == 404
    shutil.rmtree(client.folder / job[6:])
    assert client.get("/open").status == 200
