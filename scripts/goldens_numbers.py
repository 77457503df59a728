"""Contents of calib's files and texts as JSON that can be stored and compared; for goldens.py."""

# ruff: noqa: ANN401  JSON is anything

from __future__ import annotations

import csv
import json
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

#: Keys that are not kept, wherever they stand: times, versions, hashes, iterations of the solver.
IGNORED = {
    "versions",
    "sha256",
    "urdf_sha256",
    "seconds",
    "time",
    "iterations",
    "evaluations",
    "message",
    "history",
    "calib",
    "schema",
    "measured",
    "hash",
    "run",
    "checksums",
}

#: Endings of files whose contents are kept; of pages only that they were written.
KEPT = (".json", ".urdf", ".csv", ".yaml", ".conf", ".toml", ".md", ".html")

#: Beginnings of printed lines that are not kept.
UNPRINTED = ("Solver", "calib ", "Written", "No URDF", "Speed", "Time")

#: Longest list that is kept as it is; of a longer one a digest is.
LONGEST = 40

#: A number in a text.
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w])")


def file_content(path: Path) -> Any:
    """Return what is kept of a file."""
    if path.suffix == ".html":
        return "written"
    if path.suffix == ".urdf":
        return urdf_poses(path)
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        return json_content(json.loads(text))
    if path.suffix == ".csv":
        return csv_columns(text)
    if path.suffix == ".md":
        return {"text": text_numbers(text)}
    return text_numbers(re.sub(r"(?m)^\s*#.*$", "", text))


def json_content(value: Any) -> Any:
    """Return what is kept of a JSON value: lists of tables as tables of lists, sentences as their numbers."""
    if isinstance(value, dict):
        return {key: json_content(v) for key, v in value.items() if key not in IGNORED}
    if isinstance(value, list):
        if value and all(isinstance(v, dict) for v in value):
            keys = sorted({key for v in value for key in v} - IGNORED)
            return {key: json_content([v.get(key) for v in value]) for key in keys}
        return list_content(value)
    if isinstance(value, str) and _is_sentence(value):
        return {"#text": NUMBER.findall(value)}
    return rounded(value)


def list_content(values: list[Any]) -> Any:
    """Return what is kept of a list of numbers or words, of any depth: all of it, or a digest."""
    flat = list(_flatten(values))
    if any(isinstance(v, dict) for v in flat):
        return [json_content(v) for v in values]
    if any(isinstance(v, str) for v in flat):
        return _words_content([v if isinstance(v, str) else repr(v) for v in flat])
    if len(flat) <= LONGEST:
        return [rounded(v) for v in flat]
    return _numbers_digest(flat)


def csv_columns(text: str) -> dict[str, Any]:
    """Return what is kept of a CSV table, by column."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    columns: dict[str, Any] = {}
    for name, *cells in zip(*csv.reader(lines), strict=True):
        stripped = [cell.strip() for cell in cells]
        values: list[Any] = list(cells)
        if all(NUMBER.fullmatch(cell) or not cell for cell in stripped):
            values = [float(cell) if cell else None for cell in stripped]
        columns[name] = list_content(values)
    return columns


def text_numbers(text: str) -> dict[str, list[str]]:
    """Return the numbers of each line that has some, by the first words of the line."""
    numbers: dict[str, list[str]] = {}
    for line in text.splitlines():
        found = NUMBER.findall(line)
        if found and not line.strip().startswith(UNPRINTED):
            words = re.sub(r"[^A-Za-z#]+", " ", NUMBER.sub("#", line)).split()
            numbers.setdefault(" ".join(words)[:40], []).extend(found)
    for key, values in numbers.items():
        if len(values) > LONGEST:
            numbers[key] = [*values[:LONGEST], str(len(values))]
    return numbers


def urdf_poses(path: Path) -> dict[str, list[float]]:
    """Return poses of a URDF's last links at three sets of joint values, by Pinocchio.

    Returns:
        By link: position and two columns of the rotation matrix of each pose, in one list.
    """
    text = path.read_text(encoding="utf-8")
    model = pin.buildModelFromXML(text)
    data = model.createData()
    joints = ElementTree.fromstring(text).findall("joint")
    parents = {element.attrib["link"] for joint in joints for element in joint.iter("parent")}
    children = {element.attrib["link"] for joint in joints for element in joint.iter("child")}
    names = sorted(joint.attrib["name"] for joint in joints)
    poses: dict[str, list[float]] = {link: [] for link in sorted(children - parents)}
    for k in range(3):
        values = {name: 0.7 * np.sin(1.0 + i + 2.0 * k) for i, name in enumerate(names)}
        pin.framesForwardKinematics(model, data, _configuration(model, values))
        for link, numbers in poses.items():
            pose = data.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous
            numbers += [rounded(float(number)) for number in pose[:3, [3, 0, 1]].T.ravel()]
    return poses


def _configuration(model: pin.Model, values: dict[str, float]) -> Any:
    """Return Pinocchio's configuration vector of joint values by name; fixed joints have none."""
    q = pin.neutral(model)
    for name in list(model.names)[1:]:
        joint = model.joints[model.getJointId(name)]
        value = values[name]
        # Of a joint without limits the configuration has cosine and sine.
        q[joint.idx_q : joint.idx_q + joint.nq] = (
            value if joint.nq == 1 else (np.cos(value), np.sin(value))
        )
    return q


def rounded(value: Any) -> Any:
    """Return a number without its last digits, which no two machines share; other values as they are."""
    return float(f"{value:.13g}") if isinstance(value, float) else value


def _is_sentence(text: str) -> bool:
    """Return True if a text has four words or more."""
    return text.count(" ") > 2


def _words_content(words: list[str]) -> Any:
    """Return what is kept of a list of words."""
    if any(_is_sentence(word) for word in words):
        return {"#text": NUMBER.findall(" ".join(words))}
    if len(words) <= LONGEST:
        return words
    return {"n": len(words), "crc": zlib.crc32("\n".join(words).encode())}


def _numbers_digest(values: list[Any]) -> dict[str, Any]:
    """Return count, rms, maximum and a weighted mean of many numbers, of which some may be None."""
    numbers = np.array([float(value) for value in values if value is not None])
    if not numbers.size:
        return {"n": 0, "of": len(values)}
    weights = np.cos(np.arange(numbers.size))
    digest = {
        "n": int(numbers.size),
        "rms": rounded(float(np.sqrt(np.mean(numbers**2)))),
        "max": rounded(float(abs(numbers).max())),
        "wave": rounded(float(numbers @ weights) / numbers.size),
    }
    if numbers.size < len(values):
        digest["of"] = len(values)
    return digest


def _flatten(values: list[Any]) -> Iterator[Any]:
    """Yield the values of lists within lists, in order."""
    for value in values:
        if isinstance(value, list):
            yield from _flatten(value)
        else:
            yield value
