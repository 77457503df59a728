"""Files that browsers send, over a real socket: names, limits, faults; and names as they are kept."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from pathlib import Path

import pytest

from calib.example import paper_measurements, paper_urdf
from calib.verbs.app.uploads import MOST_BYTES, MOST_TOGETHER, free_name, safe_name
from tests.verbs.app.served import BOUNDARY, Client, upload_headers

NAMES = {
    "robot.urdf": "robot.urdf",
    "C:\\Users\\me\\robot.urdf": "robot.urdf",
    "../../etc/passwd": "passwd",
    "..": "file",
    "": "file",
    ".job.json": "job.json",
    ".run": "run",
    "-o": "_o",
    "--accept.csv": "_-accept.csv",
    "a=b.csv": "a_b.csv",
    "data.xlsx#Sheet": "data.xlsx_Sheet",
    "robot.xacro a:=b": "robot.xacro a__b",
    "<script>alert(1)</script>.csv": "script_.csv",
    "a\x00b\n.csv": "a_b_.csv",
    "Größe 1.csv": "Größe 1.csv",
    "con.csv": "_con.csv",
    "x" * 300 + ".csv": "x" * 96 + ".csv",
}


@pytest.mark.parametrize("sent", NAMES)
def test_names_as_they_are_kept(sent: str):
    assert safe_name(sent) == NAMES[sent]


def test_names_that_are_taken():
    assert free_name("a.csv", {"A.CSV", "a-2.csv"}) == "a-3.csv"


def files_of(folder: Path) -> list[str]:
    """All files below a folder but the token."""
    return sorted(
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".token"
    )


@pytest.mark.parametrize(
    "name", ["../../outside.urdf", "..\\outside.urdf", "/tmp/outside.urdf", "%2e%2e%2foutside.urdf"]
)
def test_a_file_never_leaves_its_folder(client: Client, name: str):
    answer = client.upload("/open", [("files", name, paper_urdf().read_bytes())])
    (job,) = client.folder.glob("0*")
    assert answer.to == f"/jobs/{job.name}"
    assert [path.suffix for path in job.iterdir() if not path.name.startswith(".")] == [".urdf"]
    assert not list(client.folder.parent.glob("*.urdf"))


def test_an_input_is_not_called_like_an_output(client: Client):
    job = client.open(("corrected.urdf", paper_urdf().read_bytes()), ("Result.json", b"{}"))
    assert {"input-corrected.urdf", "input-Result.json"} <= set(
        files_of(client.folder / job.split("/")[-1])
    )


def table_of(size: int) -> Iterator[bytes]:
    """The body of an upload of one table of so many bytes, in pieces."""
    yield (
        f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="files"; filename="big.csv"\r\n\r\n'
    ).encode()
    piece = b"1,2,3\n" * 10_000
    for _ in range(size // len(piece)):
        yield piece
    yield f"\r\n--{BOUNDARY}--\r\n".encode()


@pytest.mark.parametrize("says_size", [True, False])
def test_a_table_of_200_mb_is_refused_while_it_arrives(client: Client, says_size: bool):
    headers = upload_headers()
    if says_size:
        headers["Content-Length"] = str(sum(map(len, table_of(200_000_000))))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    answer = client.ask("POST", "/open", table_of(200_000_000), headers)
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    assert answer.status == 413
    assert f"more than {MOST_BYTES // 1_000_000} MB" in answer.text
    assert grown < MOST_BYTES
    assert files_of(client.folder) == []


def test_more_than_all_together_is_refused_before_it_is_read(client: Client):
    headers = {**upload_headers(), "Content-Length": str(MOST_TOGETHER + 1)}
    answer = client.ask("POST", "/open", iter(()), headers)
    assert answer.status == 413
    assert "4,000 MB" in answer.text


def test_a_file_that_calib_does_not_read_is_refused(client: Client):
    answer = client.upload("/open", [("files", "notes.docx", b"PK")])
    assert answer.status == 400
    assert "notes.docx" in answer.text
    assert files_of(client.folder) == []


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"nothing",
        f"--{BOUNDARY}\r\n".encode(),
        f"--{BOUNDARY}\r\nContent-Disposition: form-data\r\n\r\nx".encode(),
        f"--{BOUNDARY}\r\n\r\n\r\n--{BOUNDARY}--\r\n".encode(),
    ],
)
def test_a_damaged_upload_is_refused_in_words(client: Client, body: bytes):
    answer = client.ask("POST", "/open", body, upload_headers())
    assert answer.status == 400
    assert "<h1>" in answer.text
    assert "Traceback" not in answer.text
    assert files_of(client.folder) == []


def test_what_is_no_upload_is_refused_in_words(client: Client):
    assert client.post("/open", key="1").status == 400
    assert client.upload("/example", []).status == 400
    long = {"Content-Type": "application/x-www-form-urlencoded"}
    assert client.ask("POST", "/example", b"a=" + b"x" * 500_000, long).status == 413
    assert client.ask("POST", "/example", b"\xff\xfe=1", long).status == 400


def test_an_upload_that_is_sent_twice_makes_one_job(client: Client):
    key = client.get("/open").key()
    jobs = {client.open(paper_urdf(), paper_measurements(), key=key) for _ in range(3)}
    assert len(jobs) == 1
    assert len(list(client.folder.glob("0*"))) == 1


def test_code_in_a_cell_file_is_not_run(client: Client, tmp_path: Path):
    mark = tmp_path / "mark"
    plugin = tmp_path / "plugin.py"
    plugin.write_text(f"open({str(mark)!r}, 'w')\n")
    cell = f'plugins = ["{plugin}"]\n'.encode()
    answer = client.upload("/open", [("files", "cell.toml", cell)])
    assert answer.status == 400
    assert "plugins" in answer.text
    assert not mark.exists()
    job = client.open(paper_urdf(), paper_measurements())
    assert client.upload(f"{job}/files", [("files", "own.toml", cell)]).status == 400
    client.get(job)
    assert not mark.exists()
