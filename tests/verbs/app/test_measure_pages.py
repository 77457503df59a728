"""Sessions through HTTP: measured by a virtual operator who types, and what reloads, mistakes and restarts do."""

from __future__ import annotations

import json
import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.result.calibration import Calibration
from calib.verbs.measure.session import Session
from tests.verbs.app.measured import arm, begun, hidden, measure, operator, shown_pose, typed
from tests.verbs.app.served import Answer, Client, served

pytestmark = pytest.mark.slow


def events(client: Client, job: str) -> list[dict]:
    path = client.folder / job[6:] / "session" / "journal.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()]


def rows(client: Client, job: str) -> int:
    return sum(event["event"] == "row" for event in events(client, job))


def test_from_the_first_pose_to_the_verdict(client: Client):
    job = begun(client)
    person = operator()
    count = 0
    while "The aim is reached" not in (page := client.get(job).text):
        measure(client, job, person)
        count += 1
        assert count < 25
    assert count >= 5
    assert "points=" in page  # the curve
    assert "Expected error" in page
    made = client.post(f"{job}/finish", key="f").to
    assert client.post(f"{job}/finish", key="f").to == made
    assert client.wait(made) == "done"
    text = client.get(made).text
    assert "Verdict: use" in text
    result = Calibration.read_json(client.folder / made[6:] / "result.json")
    assert result.record.robot_serial == "SN-10"
    assert len(result.rows) >= count - 1
    # The true arm, at poses that nobody measured, in its own frames.
    truth = person.virtual.truth.robot
    q = np.random.default_rng(3).uniform(-1.5, 1.5, (200, 6))
    own, true = (robot.poses(q) for robot in (result.robot, truth))
    nominal = arm().poses(q)
    apart = [
        np.linalg.norm(np.diff(T[:, :3, 3] - true[:, :3, 3], axis=0), axis=1).mean()
        for T in (own, nominal)
    ]
    assert apart[0] < 0.5 * apart[1]


def test_a_form_that_is_sent_twice_adds_one_row(client: Client):
    job = begun(client)
    form = measure(client, job, operator())
    for _ in range(3):
        assert client.form(f"{job}/reading", form).status == 303
    assert rows(client, job) == 1
    for _ in range(2):
        client.post(f"{job}/undo", key="u")
    client.post(f"{job}/note", key="n", note="warm")
    client.post(f"{job}/note", key="n", note="warm")
    assert [event["event"] for event in events(client, job)] == ["row", "answer", "undo", "note"]
    assert "warm" in client.get(job).text


def test_two_browsers_see_the_same_and_add_one_row(client: Client):
    job = begun(client)
    second = Client(client.port, client.token, client.folder).enter()
    pages = [one.get(job) for one in (client, second)]
    assert shown_pose(pages[0]).tolist() == shown_pose(pages[1]).tolist()
    xyz = operator().measure(shown_pose(pages[0])).readings.points[0]
    answers = []
    threads = [
        threading.Thread(
            target=lambda c=c, p=p: answers.append(c.form(f"{job}/reading", typed(xyz, p)))
        )
        for c, p in zip((client, second), pages, strict=True)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answer.status for answer in answers) == [303, 409]
    refused = next(answer for answer in answers if answer.status == 409)
    assert "The pose has changed meanwhile" in refused.text
    assert (
        f'value="{1e3 * xyz[0]:.4f}"'.replace(".", ",") in refused.text
    )  # what was typed is not lost
    assert rows(client, job) == 1
    live = [one.get(f"{job}/live?v=old") for one in (client, second)]
    assert live[0].headers["x-version"] == live[1].headers["x-version"]
    version = live[0].headers["x-version"]
    assert client.get(f"{job}/live?v={version}").status == 204
    client.post(f"{job}/note", key="n", note="x")
    assert second.get(f"{job}/live?v={version}").status == 200


def test_what_is_no_number_is_refused_and_nothing_is_added(client: Client):
    job = begun(client)
    page = client.get(job)
    form = typed(np.ones(3), page)
    for name, text in (
        ("value:target:x [mm]", "ten"),
        ("value:target:y [mm]", ""),
        ("value:target:z [mm]", "1;2"),
    ):
        answer = client.form(f"{job}/reading", form | {name: text})
        assert answer.status == 409
        assert "no number" in answer.text
    assert client.form(f"{job}/reading", hidden(page)).status == 409
    for joints in ("1 2 3", "a b c d e f"):
        answer = client.form(f"{job}/reading", form | {"joints": joints})
        assert answer.status == 409
        assert '<blockquote lang="en">' in answer.text
    assert rows(client, job) == 0


def test_joint_values_may_be_typed_where_the_robot_stands_elsewhere(client: Client):
    job = begun(client)
    page = client.get(job)
    q = shown_pose(page) + 0.01
    xyz = operator().measure(q).readings.points[0]
    joints = " ".join(f"{value:.4f}".replace(".", ",") for value in np.rad2deg(q))
    assert client.form(f"{job}/reading", typed(xyz, page) | {"joints": joints}).status == 303
    row = next(event for event in events(client, job) if event["event"] == "row")
    assert np.deg2rad(row["columns"]["elbow_joint [deg]"][0]) == pytest.approx(q[2], abs=1e-5)


def test_a_mistake_is_named_at_its_stop_and_measured_again(client: Client):
    job = begun(client)
    person = operator(r16="gross")
    for _ in range(16):
        measure(client, job, person)
    page = client.get(job).text
    assert '<section class="verdict bad"' in page
    stop = re.search(r"Measure stop (\d+) again.", page)[1]  # type: ignore[index]
    assert f"Again: stop {stop}" in page
    measure(client, job, person)
    assert '<section class="verdict good"' in client.get(job).text


def test_undo_skip_pause_and_too_few_stops(client: Client):
    job = begun(client)
    person = operator()
    first = shown_pose(client.get(job))
    page = client.get(job)
    for _ in range(2):  # the second is about a pose that is gone
        client.post(f"{job}/skip", key=str(_), pose=hidden(page)["pose"])
    assert shown_pose(client.get(job)).tolist() != first.tolist()
    assert sum(event["event"] == "skip" for event in events(client, job)) == 1
    measure(client, job, person)
    client.post(f"{job}/undo", key="u1")
    assert "Stops that count: 0." in client.get(job).text
    assert "Stop 1 is taken back." in client.get(job).text
    form = typed(np.ones(3), client.get(job))
    client.post(f"{job}/pause", key="p1", to="pause")
    text = client.get(job).text
    assert "The session pauses" in text
    assert 'id="entry"' not in text
    assert client.form(f"{job}/reading", form).status == 409
    client.post(f"{job}/undo", key="u2")
    assert client.get(f"{job}/live?v=paused").status == 204
    assert client.get(f"{job}/live?v=1").headers["x-paused"] == "true"
    folder = client.folder / job[6:] / "session"
    with Session.open(folder) as session:  # another process has it now
        assert session.state.measured == 0
        answer = client.post(f"{job}/pause", key="p2", to="resume")
        assert answer.status == 409
        assert '<blockquote lang="en">' in answer.text
    client.post(f"{job}/pause", key="p3", to="resume")
    assert 'id="entry"' in client.get(job).text
    answer = client.post(f"{job}/finish", key="f")
    assert answer.status == 409
    assert "at least 5 stops" in answer.text


def test_a_session_goes_on_after_a_restart_and_is_held_by_one(tmp_path: Path):
    person = operator()
    with served(tmp_path, "en") as client:
        job = begun(client.enter())
        for _ in range(4):
            measure(client, job, person)
        pose = shown_pose(client.get(job))
        with served(tmp_path, "en") as other:
            answer = other.enter().get(job)
            assert answer.status == 400
            assert '<blockquote lang="en">' in answer.text
    with served(tmp_path, "en") as client:
        client.enter()
        assert shown_pose(client.get(job)).tolist() == pytest.approx(pose.tolist(), abs=1e-4)
        measure(client, job, person)
        assert "Stops that count: 5." in client.get(job).text
    folder = tmp_path / job[6:] / "session"
    with Session.open(folder) as session:
        assert session.state.stops == 5
    assert len(Measurements.read(folder / "measurements.csv")) == 5


def test_readings_of_an_instrument_are_added_as_they_come(client: Client, tmp_path: Path):
    """A tracker's program that writes one line after the other into a file."""
    exported = tmp_path / "points.txt"
    exported.write_text("x [mm];y [mm];z [mm]\n")
    job = begun(client, reader=f"file:{exported}")
    person = operator()
    for count in range(1, 4):
        page = client.get(job)
        assert "Waiting for the instrument" in page.text
        version = re.search(r'data-version="([^"]+)"', page.text)[1]  # type: ignore[index]
        xyz = 1e3 * person.measure(shown_pose(page)).readings.points[0]
        with exported.open("a") as file:
            file.write(f"{xyz[0]:.4f};{xyz[1]:.4f};{xyz[2]:.4f}\n")
        end = time.monotonic() + 20.0
        while client.get(f"{job}/live?v={version}").status == 204:
            assert time.monotonic() < end
            time.sleep(0.1)
        assert f"Stops that count: {count}." in client.get(job).text
    with exported.open("a") as file:
        file.write("one;two;three\n")
    end = time.monotonic() + 20.0
    while "The last reading was not taken" not in (text := client.get(job).text):
        assert time.monotonic() < end
        time.sleep(0.1)
    assert "'one' is not a number" in text
    assert rows(client, job) == 3


def until(client: Client, job: str, count: int) -> None:
    """Wait until a session has so many rows."""
    end = time.monotonic() + 20.0
    while rows(client, job) < count:
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_rehearsal_measures_when_a_person_says_so(client: Client):
    job = client.upload("/measure", [], robot_name="ur10e").to
    form = form_of(client.get(job)) | {"noise": "0.03", "action": "rehearse"}
    assert client.form(f"{job}/choose", form).status == 303
    for count in range(1, 4):
        assert f'action="{job}/go"' in client.get(job).text
        time.sleep(0.5)
        assert rows(client, job) == count - 1
        client.post(f"{job}/go", key=f"g{count}")
        client.post(f"{job}/go", key=f"g{count}")
        until(client, job, count)
    time.sleep(0.5)
    assert rows(client, job) == 3


def test_the_answer_has_the_button_when_the_aim_is_reached(client: Client):
    job = begun(client, aim="3 mm")
    person = operator()
    for _ in range(25):
        measure(client, job, person)
        text = client.get(job).text
        box = text.partition('<section class="verdict')[2].partition("</section>")[0]
        is_reached = f'action="{job}/finish"' in box
        assert is_reached == ("✓ The aim is reached" in box)
        if is_reached:
            return
    raise AssertionError("the aim was not reached")


def test_an_instrument_that_comes_by_itself_stops_at_the_aim(client: Client, tmp_path: Path):
    exported = tmp_path / "points.txt"
    exported.write_text("x [mm];y [mm];z [mm]\n")
    job = begun(client, reader=f"file:{exported}", aim="3 mm")
    person = operator()
    count = 0

    def show() -> None:
        page = client.get(job)
        xyz = 1e3 * person.measure(shown_pose(page)).readings.points[0]
        with exported.open("a") as file:
            file.write(f"{xyz[0]:.4f};{xyz[1]:.4f};{xyz[2]:.4f}\n")

    while "The aim is reached" not in client.get(job).text:
        show()
        count += 1
        until(client, job, count)
        assert count < 25
    show()
    time.sleep(1.0)
    assert rows(client, job) == count
    client.post(f"{job}/go", key="on")
    time.sleep(0.5)
    show()
    until(client, job, count + 1)


@pytest.mark.parametrize(
    "chosen",
    [
        {"aim": "far"},
        {"aim": "0 mm"},
        {"noise": "little"},
        {"poses": "many"},
        {"poses": "100000"},
        {"reader": "pigeon:home"},
        {"controller": "pigeon:home"},
        {"reader": "file:"},
    ],
)
def test_a_setup_with_a_fault_says_so_and_begins_nothing(client: Client, chosen: dict[str, str]):
    job = client.upload("/measure", [], robot_name="ur10e").to
    fields = {"action": "measure", "was:poses": "40", "poses": "40"}
    fields |= {f"was:{name}": "-" for name in chosen} | chosen
    answer = client.form(f"{job}/choose", fields)
    assert answer.status == 400
    assert '<blockquote lang="en">' in answer.text
    assert "Traceback" not in answer.text


def field_of(page: Answer, name: str) -> tuple[str, bool]:
    """What a field of a setup shows, and whether it is marked as wrong."""
    tag = re.search(rf'<input id="f-{name}" [^>]*>', page.text)
    assert tag is not None
    shown = re.search(r' value="([^"]*)"', tag[0])
    assert shown is not None
    return shown[1], 'aria-invalid="true"' in tag[0]


def form_of(page: Answer) -> dict[str, str]:
    """The form of a setup as a browser would send it."""
    form = page.text.partition('id="reading">')[2].partition("</form>")[0]
    tags = re.findall(r"<input [^>]*>", form)
    pairs = [re.search(r'name="([^"]+)" value="([^"]*)"', tag) for tag in tags]
    fields = {pair[1]: pair[2] for pair in pairs if pair is not None}
    for name, options in re.findall(r'<select [^>]*name="([^"]+)".*?>(.*?)</select>', form, re.S):
        fields[name] = re.findall(r'value="([^"]*)" selected', options)[0]
    return fields


def test_a_setup_keeps_what_was_typed_and_marks_the_field_until_it_is_right(client: Client):
    job = client.upload("/measure", [], robot_name="ur10e").to
    form = form_of(client.get(job)) | {"aim": "5 nm", "target": "1 2 3", "serial": "SN-7"}
    answer = client.form(f"{job}/choose", form | {"action": "measure"})
    assert answer.status == 400
    assert field_of(answer, "aim") == ("5 nm", True)
    assert field_of(answer, "target") == ("1 2 3", True)
    assert field_of(answer, "serial") == ("SN-7", False)
    assert 'id="f-target-fault"' in answer.text
    assert 'id="f-serial-fault"' not in answer.text
    emptied = form_of(answer)
    assert emptied["was:aim"] == "5 nm"
    answer = client.form(f"{job}/choose", emptied | {"aim": "0,2", "action": "measure"})
    assert answer.status == 400
    assert field_of(answer, "aim") == ("0,2", False)
    assert field_of(answer, "target") == ("1 2 3", True)
    answer = client.form(
        f"{job}/choose", form_of(answer) | {"robot_name": "pigeon", "action": "look"}
    )
    assert answer.status == 400
    assert field_of(answer, "robot_name") == ("pigeon", True)
    last = form_of(answer) | {"robot_name": "ur10e", "target": "", "action": "measure"}
    assert client.form(f"{job}/choose", last).status == 303
    kept = json.loads((client.folder / job[6:] / "session" / "session.json").read_text())
    assert kept["aim"]["error_m"] == pytest.approx(2e-4)
    assert "target_mm" not in (client.folder / job[6:] / "cell.toml").read_text()


def test_a_session_whose_instrument_is_not_there_can_be_set_up_again(client: Client):
    job = client.upload("/measure", [], robot_name="ur10e").to
    form = form_of(client.get(job)) | {"reader": "file:", "action": "measure"}
    answer = client.form(f"{job}/choose", form)
    assert answer.status == 400
    assert field_of(answer, "reader")[0] == "file:"
    right = form_of(answer) | {"reader": "", "action": "measure"}
    assert client.form(f"{job}/choose", right).status == 303
    assert 'id="entry"' in client.get(job).text


def test_the_ghost_is_a_page_of_its_own(client: Client):
    job = begun(client)
    answer = client.get(f"{job}/ghost?pose=x")
    assert (
        answer.headers["content-security-policy"] == "sandbox allow-scripts; frame-ancestors 'self'"
    )
    assert b"next pose" in answer.body
    measure(client, job, operator())
    assert b"where it stands" in client.get(f"{job}/ghost?pose=y").body


def test_a_session_without_a_robot_says_what_is_missing(client: Client):
    assert client.upload("/measure", []).status == 400
    job = client.upload("/measure", [("files", "cell.toml", b'kind = "point"\n')]).to
    text = client.get(job).text
    assert "The robot is missing still" in text
    assert client.post(f"{job}/choose", action="measure").status == 400
    client.post(f"{job}/remove")
    assert client.get(job).status == 404


def test_two_targets_have_a_row_of_fields_each(client: Client):
    cell = b"""base = "base_link"
tip = "tool0"
frame = "estimate"
sigma_mm = 0.03
[targets_mm]
a = [70.0, 0.0, 20.0]
b = [-40.0, 60.0, 20.0]
"""
    job = client.upload("/measure", [("files", "two.toml", cell)], robot_name="ur10e").to
    assert client.post(f"{job}/choose", action="measure").status == 303
    page = client.get(job)
    form = hidden(page)
    for name, places in (("a", (500, 1, 2)), ("b", (510, 3, 4))):
        form |= {f"value:{name}:{axis} [mm]": str(v) for axis, v in zip("xyz", places, strict=True)}
    assert all(name in page.text for name in form)
    assert client.form(f"{job}/reading", form).status == 303
    row = next(event for event in events(client, job) if event["event"] == "row")
    assert row["columns"]["target"] == ["a", "b"]
    lone = hidden(client.get(job)) | {f"value:b:{axis} [mm]": "400" for axis in "xyz"}
    answer = client.form(f"{job}/reading", lone)
    assert answer.status == 303, re.findall(r"<blockquote.*?</blockquote>", answer.text)
    assert [e["columns"]["target"] for e in events(client, job) if e["event"] == "row"][1] == ["b"]


def test_a_session_with_a_camera_is_for_the_command_line(client: Client):
    files = [("files", "own.toml", b'kind = "pixel"\n')]
    job = client.upload("/measure", files, robot_name="ur10e").to
    assert "calib measure" in client.get(job).text
    assert client.post(f"{job}/choose", action="measure").status == 400
