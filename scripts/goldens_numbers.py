"""What a file or a text of calib holds, as numbers, and where two of them differ; for goldens.py."""

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
from scipy.spatial.transform import Rotation

# Keys that are not compared, wherever they stand: times, versions, hashes, the solver's way.
IGNORED = {
    *(
        "versions",
        "sha256",
        "urdf_sha256",
        "seconds",
        "iterations",
        "evaluations",
        "message",
        "history",
    ),
    *("calib", "schema", "measured", "hash"),
}
STRICT, LOOSE = 1e-9, 1e-6  # relative; the second for all that hangs on a restricted likelihood
FLOOR = {STRICT: 1e-13, LOOSE: 1e-10}
KEPT = (".json", ".urdf", ".csv", ".yaml", ".conf", ".toml", ".md", ".html")
BESIDE_STD = ("value", "delta", "nominal", "low", "high")
LONGEST = 40  # a longer list is kept as a digest
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w])")
UNTOLD = (
    "Solver",
    "calib ",
    "Written",
    "No URDF",
    "Speed",
    "Time",
)  # lines of stdout that are not kept
Step = tuple[
    str, str, np.ndarray, np.ndarray
]  # a joint: its name, type, axis, and pose in the joint before


def tidy(value: Any) -> Any:
    """JSON as it is kept: lists of tables as tables of lists, long lists as digests, sentences as their numbers."""
    if isinstance(value, dict):
        return {k: tidy(v) for k, v in value.items() if k not in IGNORED}
    if isinstance(value, list) and value and all(isinstance(v, dict) for v in value):
        keys = sorted({k for v in value for k in v} - IGNORED)
        return {k: tidy([v.get(k) for v in value]) for k in keys}
    if isinstance(value, list):
        return tidy_list(value)
    if isinstance(value, str) and value.count(" ") > 2:
        return {"#text": NUMBER.findall(value)}
    return short(value) if isinstance(value, float) else value


def tidy_list(values: list[Any]) -> Any:
    """A list of numbers or words, of whatever depth."""
    flat = list(flatten(values))
    if any(isinstance(v, dict) for v in flat):
        return [tidy(v) for v in values]
    if any(isinstance(v, str) for v in flat):
        words = [v if isinstance(v, str) else repr(v) for v in flat]
        if any(w.count(" ") > 2 for w in words):
            return {"#text": NUMBER.findall(" ".join(words))}
        return (
            words
            if len(words) <= LONGEST
            else {"n": len(words), "crc": zlib.crc32("\n".join(words).encode())}
        )
    if len(flat) <= LONGEST:
        return [short(v) if isinstance(v, float) else v for v in flat]
    known = np.array([float(v) for v in flat if v is not None])
    if not known.size:
        return {"n": 0, "of": len(flat)}
    size = float(np.sqrt(np.mean(known**2)))
    wave = float(known @ np.cos(np.arange(known.size))) / known.size
    found = {
        "n": int(known.size),
        "rms": short(size),
        "max": short(float(abs(known).max())),
        "wave": short(wave),
    }
    return found | ({"of": len(flat)} if len(flat) > known.size else {})


def flatten(values: Any) -> Iterator[Any]:
    """The values of lists within lists, in order."""
    for value in values:
        if isinstance(value, list):
            yield from flatten(value)
        else:
            yield value


def short(value: float) -> float:
    """A number without its last digits, which no two machines share."""
    return float(f"{value:.13g}")


def table(text: str) -> Any:
    """The columns of a CSV table."""
    rows = list(
        csv.reader(line for line in text.splitlines() if line.strip() and not line.startswith("#"))
    )
    columns: dict[str, Any] = {}
    for name, *cells in zip(*rows, strict=True):
        numbers = all(NUMBER.fullmatch(c.strip()) or not c.strip() for c in cells)
        columns[name] = tidy_list(
            [float(c) if c.strip() else None for c in cells] if numbers else list(cells)
        )
    return columns


def lines(text: str) -> dict[str, list[str]]:
    """The numbers of each line that has any, by the words of the line."""
    found: dict[str, list[str]] = {}
    for line in text.splitlines():
        numbers = NUMBER.findall(line)
        if not numbers or line.strip().startswith(UNTOLD):
            continue
        words = " ".join(re.sub(r"[^A-Za-z#]+", " ", NUMBER.sub("#", line)).split())[:40]
        found.setdefault(words, []).extend(numbers)
    return {k: v if len(v) <= LONGEST else [*v[:LONGEST], f"{len(v)}"] for k, v in found.items()}


def poses(path: Path) -> dict[str, list[float]]:
    """Poses of a URDF's last links at three sets of joint values: position, and two columns of the rotation."""
    joints = by_child(path)
    names = sorted(j.attrib["name"] for j in joints.values())
    ends = set(joints) - {j.find("parent").attrib["link"] for j in joints.values()}
    values = [{n: 0.7 * np.sin(1.0 + i + 2.0 * k) for i, n in enumerate(names)} for k in range(3)]
    return {
        e: [
            short(float(v))
            for q in values
            for v in forward(steps(joints, e), q)[:3, [3, 0, 1]].T.ravel()
        ]
        for e in sorted(ends)
    }


def by_child(path: Path) -> dict[str, Any]:
    """A URDF's joints by the link behind them."""
    children = ((j.find("child"), j) for j in ElementTree.parse(path).iter("joint"))
    return {c.attrib["link"]: j for c, j in children if c is not None}


def steps(joints: dict[str, Any], link: str, base: str = "") -> list[Step]:
    """The joints from the root, or from a link in the chain, to a link; `joints` are a URDF's, by their child link."""
    found: list[Step] = []
    while link in joints and link != base:
        joint = joints[link]
        placed = np.eye(4)
        if (origin := joint.find("origin")) is not None:
            placed[:3, 3] = [float(v) for v in origin.attrib.get("xyz", "0 0 0").split()]
            placed[:3, :3] = Rotation.from_euler(
                "xyz", [float(v) for v in origin.attrib.get("rpy", "0 0 0").split()]
            ).as_matrix()
        axis = joint.find("axis")
        along = np.array(
            [float(v) for v in (axis.attrib["xyz"] if axis is not None else "1 0 0").split()]
        )
        found.append((joint.attrib["name"], joint.attrib["type"], along, placed))
        link = joint.find("parent").attrib["link"]
    return found[::-1]


def forward(chain: list[Step], values: dict[str, float]) -> np.ndarray:
    """Pose of the last link."""
    pose = np.eye(4)
    for name, kind, along, placed in chain:
        moved, q = np.eye(4), values.get(name, 0.0)
        if kind == "prismatic":
            moved[:3, 3] = q * along
        elif kind in ("revolute", "continuous"):
            moved[:3, :3] = Rotation.from_rotvec(q * along / np.linalg.norm(along)).as_matrix()
        pose = pose @ placed @ moved
    return pose


def content(path: Path) -> Any:
    """What is kept of a file; of a picture or a page only that it is there."""
    if path.suffix == ".json":
        return tidy(json.loads(path.read_text(encoding="utf-8")))
    if path.suffix == ".urdf":
        return poses(path)
    if path.suffix == ".csv":
        return table(path.read_text(encoding="utf-8"))
    if path.suffix in (".yaml", ".conf", ".toml"):
        return lines(re.sub(r"(?m)^\s*#.*$", "", path.read_text(encoding="utf-8")))
    if path.suffix == ".md":
        return {"text": lines(path.read_text(encoding="utf-8"))}
    return "written"


def differences(path: str, a: Any, b: Any, rel: float, ignore_text: bool) -> Iterator[str]:
    """Each place where two runs differ, with both values."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in sorted(a.keys() | b.keys()):
            if ignore_text and key in ("text", "#text"):
                continue
            if key not in a or key not in b:
                yield f"{path}/{key}: only in the {'second' if key in b else 'first'}"
            else:
                yield from entry(path, key, (a, b), rel, ignore_text)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        scale = max((abs(v) for v in [*a, *b] if isinstance(v, float)), default=0.0)
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            deeper = isinstance(x, dict) and isinstance(y, dict)
            yield from (
                differences(f"{path}/{i}", x, y, rel, ignore_text)
                if deeper
                else differ(f"{path}/{i}", x, y, rel, scale)
            )
    else:
        yield from differ(path, a, b, rel, 0.0)


def entry(
    path: str, key: str, pair: tuple[Any, Any], rel: float, ignore_text: bool
) -> Iterator[str]:
    """The differences of one entry of two tables; values of parameters beside their standard deviations."""
    path, a, b, std = f"{path}/{key}", pair[0][key], pair[1][key], pair[0].get("std")
    if isinstance(std, list) and key in (*BESIDE_STD, "push") and len(std) == len(a) == len(b):
        for i, (x, y, s) in enumerate(zip(a, b, std, strict=True)):
            yield from differ(
                f"{path}/{i}", x, y, rel, 0.0 if not s else 1 / s if key == "push" else s
            )
    elif key == "wave":  # a sum in which much cancels
        yield from differ(path, a, b, rel, max(abs(p["rms"]) for p in pair))
    else:
        yield from differences(path, a, b, rel, ignore_text)


def differ(path: str, a: Any, b: Any, rel: float, scale: float) -> Iterator[str]:
    """Whether two leaves differ; a number that was printed may differ by one in its last place."""
    last = 0.0
    if isinstance(a, str) and isinstance(b, str) and NUMBER.fullmatch(a) and NUMBER.fullmatch(b):
        last = 1.001 * 10.0 ** -len(a.partition(".")[2].partition("e")[0]) if "." in a else 0.0
        a, b = float(a), float(b)
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (a, b))
    if numbers and abs(abs(a) - np.pi) < 1e-6 > abs(a + b):  # half a turn, one way or the other
        b = -b
    if a == b or (
        numbers and abs(a - b) <= max(rel * max(abs(a), abs(b), scale), FLOOR[rel], last)
    ):
        return
    yield f"{path}: {a} | {b}"
