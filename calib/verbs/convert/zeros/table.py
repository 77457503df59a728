"""Joint zeros as a table: CSV in deg and mm, JSON in rad and m; docs/zeros.md describes the files."""

from __future__ import annotations

import csv
import io
import json
from typing import Any

from calib.basics.json_files import json_bytes
from calib.errors import FileError
from calib.robot.robot import Robot
from calib.verbs.convert.zeros.rms_errors import RmsErrors
from calib.verbs.convert.zeros.rounding import RoundedZeros

TABLE_ENDINGS = (".csv", ".json")
"""What the name of a table of zeros may end in."""

#: Headings of the CSV.
_HEADS = ("joint", "change", "unit", "std", "determined")

#: Digits of a standard deviation.
_STD_DIGITS = 2


def table_bytes(robot: Robot, rounded: RoundedZeros, rms_errors: RmsErrors, ending: str) -> bytes:
    """Return a table of zeros as the bytes of a file.

    Args:
        robot: The robot.
        rounded: Its zeros, rounded.
        rms_errors: The errors with them and without.
        ending: One of `TABLE_ENDINGS`.

    Returns:
        The file.

    Raises:
        FileError: It does not read back, as where a joint's name cannot be held.
    """
    write = _csv if ending == ".csv" else _json
    data = write(robot, rounded, rms_errors)
    if read_table(data, ending) != rounded.by_joint():
        raise FileError(
            f"The zeros of '{robot.name}' do not read back; rename its joints in the URDF."
        )
    return data


def read_table(data: bytes, ending: str) -> dict[str, float]:
    """Read the zeros of a table that calib wrote.

    Args:
        data: The file.
        ending: One of `TABLE_ENDINGS`.

    Returns:
        The change of the reading by joint [deg] or [mm], of the joints whose zero is determined.
    """
    if ending == ".json":
        joints = json.loads(data)["joints"]
        return {row["joint"]: row["change"] for row in joints if row["determined"]}
    lines = data.decode().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("# "))
    return {row["joint"]: float(row["change"]) for row in rows if row["determined"] == "yes"}


def _csv(robot: Robot, rounded: RoundedZeros, rms_errors: RmsErrors) -> bytes:
    """Return comments that say how the numbers are meant, then a line for each joint."""
    comments = [
        f"Joint zeros of {robot.name}, {robot.base} to {robot.tip}, by calib: the best ones where nothing else of the "
        "robot is corrected",
        "While the robot stands still, the reading of each joint must go up by 'change': add it to the angle or "
        "position of the mastering",
        "'determined' no: the measurements do not determine this zero; leave it as it is",
        *_rms_lines(rms_errors),
    ]
    text = io.StringIO(newline="")
    text.writelines(f"# {' '.join(line.split())}\n" for line in comments)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_HEADS)
    zeros = rounded.zeros
    for k, (name, unit) in enumerate(zip(zeros.joints, rounded.units, strict=True)):
        if not zeros.determined[k]:
            writer.writerow([name, "", unit.name, "", "no"])
            continue
        change = f"{rounded.numbers[k]:+.{unit.decimals}f}"
        std = f"{zeros.std[k] / unit.to_si:.{_STD_DIGITS}g}"
        writer.writerow([name, change, unit.name, std, "yes"])
    return text.getvalue().encode()


def _rms_lines(rms_errors: RmsErrors) -> list[str]:
    """Return the errors as comments, a line for each unit."""
    return [
        f"rms error of {rms_errors.rows} rows [{unit}]: nominal robot {rms_errors.nominal[unit]:.6g}, zeros "
        f"{rms_errors.zeros[unit]:.6g}, zeros rounded {rms_errors.rounded[unit]:.6g}, whole calibration "
        f"{rms_errors.calibrated[unit]:.6g}"
        for unit in rms_errors.zeros
    ]


def _json(robot: Robot, rounded: RoundedZeros, rms_errors: RmsErrors) -> bytes:
    """Return the same as JSON, and what was rounded, in rad and m."""
    zeros = rounded.zeros
    joints = []
    for k, (name, unit) in enumerate(zip(zeros.joints, rounded.units, strict=True)):
        si = "m" if rounded.prismatic[k] else "rad"
        determined = bool(zeros.determined[k])
        joints.append(
            {
                "joint": name,
                "determined": determined,
                "change": float(rounded.numbers[k]) if determined else None,
                "unit": unit.name,
                f"delta_{si}": float(zeros.delta[k]) if determined else None,
                f"std_{si}": float(zeros.std[k]),
            }
        )
    content: dict[str, Any] = {
        "schema": "zeros 1",
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
        "joints": joints,
        "rows": rms_errors.rows,
        "rms": {
            "nominal": rms_errors.nominal,
            "zeros": rms_errors.zeros,
            "rounded": rms_errors.rounded,
            "calibrated": rms_errors.calibrated,
        },
    }
    return json_bytes(content)
