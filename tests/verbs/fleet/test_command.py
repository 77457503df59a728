"""``calib fleet``: a manifest in, a folder of results and a table out; and what is refused."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.places import ROOT
from tests.verbs.fleet.arms import arms

DOC = ROOT / "docs" / "fleet.md"
ARM = ("--base", "base", "--tip", "tool0", "--model", "zeros", "--workers", "1")
QUICK = (*ARM, "--no-reports", "--no-validate")


@pytest.fixture
def arms_shop(tmp_path: Path, ur3) -> Path:
    """A folder with six arms and their manifest."""
    arms(tmp_path, ur3, range(6))
    manifest(tmp_path, *(f"SN-{k},robot.urdf,arm-{k}.csv" for k in range(6)))
    return tmp_path


def manifest(folder: Path, *rows: str, header: str = "name,robot,data") -> None:
    (folder / "m.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")


def test_its_bar_is_there_before_the_first_robot_is_done(call, arms_shop: Path, monkeypatch):
    counts: list[tuple[int, int]] = []

    @contextmanager
    def bar(*_: str, **__: bool) -> Iterator[Callable[[int, int], None]]:
        yield lambda *count: counts.append(count)

    monkeypatch.setattr("calib.verbs.fleet.command.progress_bar", bar)
    assert call(arms_shop, "fleet", "m.csv", "--out", "r", *QUICK).code == 0
    assert counts == [(k, 6) for k in range(7)]


@pytest.mark.slow
def test_a_fleet_is_calibrated_compared_and_kept(call, arms_shop: Path):
    done = call(arms_shop, "fleet", "m.csv", "--out", "r", *ARM, "--no-reports")
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "Errors and noise, rms [mm]"
    heads = "robot verdict urdf model nominal calibrated held-out noise rows out"
    assert " ".join(done.lines[1].split()) == heads
    assert [line.split()[0] for line in done.lines[2:8]] == [f"SN-{k}" for k in range(6)]
    assert re.fullmatch(
        r"6 of 6 robots calibrated \(.*\); \d fleet outliers?, 0 failed\.", done.lines[-3]
    )
    assert done.lines[-2:] == ["Written: r/fleet.csv", "Written: r/fleet.json"]
    again = call(arms_shop, "fleet", "m.csv", "--out", "r", *ARM, "--no-reports")
    assert "calibrated (" in again.lines[-3]
    assert ", 6 of them by an earlier run; " in again.lines[-3]
    quiet = call(
        arms_shop, "fleet", "m.csv", "--out", "r", *ARM, "--no-reports", "--quiet", "--force"
    )
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")

    table = json.loads((arms_shop / "r" / "fleet.json").read_text())
    keys = {"schema", "notes", *keys_of("robots", table), *keys_of("outliers", table)}
    for name in ("parameters", "zeros"):
        keys.remove(f"robots[].{name}")
        keys |= {f"robots[].{key}" for key in keys_of(name, table["robots"][0])}
    row = r"^\| `([a-z_\d\[\].{},]+)` \| (?:text|integer|number|list|as)[a-z, ]* \|"
    said = re.findall(row, DOC.read_text(), re.MULTILINE)
    # There may be no outliers here.
    assert {k for k in keys if not k.startswith("outliers")} == {
        k for k in each_of(said) if not k.startswith("outliers")
    }
    rows = list(csv.DictReader((arms_shop / "r" / "fleet.csv").read_text().splitlines()))
    assert [row["name"] for row in rows] == [f"SN-{k}" for k in range(6)]
    assert {row["unseen"] for row in rows} == {"cross-validation"}
    for row, one in zip(rows, table["robots"], strict=True):
        assert float(row["nominal_rms [mm]"]) == pytest.approx(
            1e3 * one["nominal_rms"]["m"], rel=1e-5
        )
        assert float(row["sigma [mm]"]) == pytest.approx(1e3 * one["sigma"]["m"], rel=1e-5)


def each_of(keys: list[str]) -> set[str]:
    """Keys as a document has them, where {a,b} stands for two."""
    result = set()
    for key in keys:
        before, opening, rest = key.partition("{")
        names, _, after = rest.partition("}")
        result |= {before + name + after for name in names.split(",")} if opening else {key}
    return result


def keys_of(name: str, table: dict[str, list[dict[str, object]]]) -> set[str]:
    return {f"{name}[].{key}" for one in table[name] for key in one}


def test_failed_robots_and_copies_are_reported(call, arms_shop: Path):
    shutil.copy(arms_shop / "arm-1.csv", arms_shop / "again.csv")
    rows = [f"SN-{k},robot.urdf,arm-{k}.csv" for k in range(6)]
    manifest(
        arms_shop,
        *rows,
        "SN-6,robot.urdf,again.csv",
        "SN-7,robot.urdf,gone.csv",
        "SN-8,ur99,arm-1.csv",
    )
    done = call(arms_shop, "fleet", "m.csv", "--out", "r", *QUICK)
    assert done.code == 1
    assert done.err == "calib: 2 of 9 robots failed.\n"
    assert done.out.count("line 9") == 1
    place = done.lines.index("Data given twice, which count once in the statistics:")
    assert done.lines[place + 1 : place + 3] == [
        "  SN-1: the same measurements as SN-6 (arm-1.csv)",
        "  SN-6: the same measurements as SN-1 (again.csv)",
    ]
    assert re.search(r"; \d fleet outliers?, 2 with the data of another, 2 failed\.", done.out)
    assert any(
        line.startswith("  SN-8: m.csv, line 10: ") and "ur99" in line for line in done.lines
    )
    assert "7 of 9 robots calibrated (7 no verdict); " in done.lines[-3]
    rows = list(csv.DictReader((arms_shop / "r" / "fleet.csv").read_text().splitlines()))
    assert rows[1]["outlier"] == "the same measurements as SN-6 (arm-1.csv)"
    assert rows[7]["status"] == "failed"
    quiet = call(arms_shop, "fleet", "m.csv", "--out", "r", *QUICK, "--quiet")
    assert (quiet.out, quiet.err) == ("", "calib: 2 of 9 robots failed.\n")
    outliers = json.loads((arms_shop / "r" / "fleet.json").read_text())["outliers"]
    said = set(re.findall(r"^\| `outliers\[\]\.([a-z]+)`", DOC.read_text(), re.MULTILINE))
    assert {key for one in outliers for key in one} == said
