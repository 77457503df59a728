"""The answer of a check as its page shows it, from the file that ``calib check --json`` writes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.files import read_bytes
from calib.data.kinds import get as kind_of
from calib.result.calibration import Calibration
from calib.show.lines import deg, mm, number, row_ranges
from calib.show.words import joint_unit
from calib.verbs.app.sentences import Sentences

#: Causes with a smaller probability are not listed; nearer to 1 than this a probability is not printed.
_LISTED, _NEAREST = 0.005, 0.999

#: With fewer poses a check shows little.
_FEW = 3

#: Shade and sign of an answer.
_SHADES = {"nothing": ("good", "✓"), "moved": ("bad", "✕"), "other": ("bad", "✕")}


@dataclass(frozen=True, slots=True)
class CauseLine:
    """A cause with its probability, how large it is, and what it does."""

    name: str
    probability: str
    size: str
    change: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Checked:
    """Content of the page of a check."""

    robot: str
    date: str
    answer: str
    shade: str
    sign: str
    ratio: str
    causes: tuple[CauseLine, ...]
    #: Change of positions by the most probable cause, and what it is compared with [mm]; empty: there is none
    change: str
    allowed: str
    matters: bool
    #: Number of further poses that would tell; 0: none are needed
    further: int
    #: Whether these are too few poses to rely on
    is_few: bool
    #: What these poses would have shown, a line for each cause, and what they cannot show; empty: nothing
    shown: tuple[str, ...]
    unseen: str


def checked_of(path: Path, result: Calibration, date: str, t: Sentences) -> Checked:
    """Read the file of a check, and word its answer.

    Args:
        path: The file.
        result: The calibration that was checked.
        date: Its date.
        t: The sentences.
    """
    table: Any = json.loads(read_bytes(path, "The check"))
    outcome = str(table["outcome"])
    shade, sign = _SHADES.get(outcome, ("care", "!"))
    images = any(result.rows.images)
    named = [
        cause
        for code, name in table["named"]
        for cause in table["causes"]
        if (cause["code"], cause["name"]) == (code, name)
    ]
    names = [_name(cause, t, images=images) for cause in named] or [
        _name(cause, t, images=images) for cause in table["causes"][:1]
    ]
    words: dict[str, str] = {}
    if outcome in ("moved", "row"):
        words = {"cause": names[0]}
    elif outcome == "undecided":
        words = {"causes": f" {t('or')} ".join(names)}
    answer = t(f"outcome_{outcome}", **words)
    change = allowed = ""
    if named and outcome not in ("row", "other") and named[0]["change_m"] is not None:
        change = mm(named[0]["change_m"])
        tolerance = table["tolerance_m"]
        allowed = mm(table["expected_m"] if tolerance is None else tolerance)
    further = table["further"]
    is_few = table["stops"] < _FEW
    if is_few and outcome == "nothing":
        shade, sign = "care", "!"
    seen, unseen = _noticed(table["noticed"], result, t, images=images)
    return Checked(
        robot=result.nominal.name,
        date=date,
        answer=answer[0].upper() + answer[1:],
        shade=shade,
        sign=sign,
        ratio=f"{table['ratio']:.2f}",
        causes=() if outcome == "nothing" else tuple(_causes(table["causes"], t, images=images)),
        change=change,
        allowed=allowed,
        matters=bool(table["matters"]),
        further=len(further["joints"]) if further else 0,
        is_few=is_few,
        shown=seen,
        unseen=unseen,
    )


def _noticed(
    noticed: list[Mapping[str, Any]], result: Calibration, t: Sentences, *, images: bool
) -> tuple[tuple[str, ...], str]:
    """Return what the poses would have shown, a line for each cause, and what they cannot show, in words."""
    kinds = [kind_of(kind) for kind in dict.fromkeys(result.rows.kinds)]
    is_turned = any(kind.is_image or kind.orientation for kind in kinds)
    lines, unseen = [], []
    for one in noticed:
        name = _name(one, t, images=images)
        if one["code"] == "joint":
            is_length = result.nominal.joint_types[one["name"]] == "prismatic"
            factor, unit = joint_unit(prismatic=is_length)
            size = one["shift_m" if is_length else "turn_rad"]
            if size is None:
                unseen.append(name)
            else:
                zero = t("noticed_zero", size=f"{number(factor * size)} {unit}")
                lines.append(f"{name}: {zero}")
            continue
        parts = []
        shift, turn = one["shift_m"], one["turn_rad"]
        if shift is not None:
            parts.append(t("noticed_shift", size=f"{mm(shift)} mm"))
        else:
            unseen.append(t("noticed_no_shift", name=name))
        if turn is not None:
            parts.append(t("noticed_turn", size=f"{deg(turn)} deg"))
        elif one["code"] != "target" or is_turned:
            unseen.append(t("noticed_no_turn", name=name))
        if parts:
            lines.append(f"{name}: {', '.join(parts)}")
    return tuple(lines), t("noticed_not", names="; ".join(unseen)) if unseen else ""


def _causes(causes: list[Mapping[str, Any]], t: Sentences, *, images: bool) -> Iterator[CauseLine]:
    """Yield the causes that may be, the most probable first."""
    for cause in causes:
        probability = cause["probability"]
        if probability < _LISTED:
            continue
        shown = f"> {_NEAREST}" if probability > _NEAREST else f"{probability:.3f}"
        change = ""
        if cause["change_m"] is not None:
            change = f"{mm(cause['change_m'])} ± {mm(cause['change_std_m'])} mm"
        yield CauseLine(_name(cause, t, images=images), shown, _size(cause), change)


def _size(cause: Mapping[str, Any]) -> str:
    """Write how large a cause is, with its uncertainty."""
    if cause.get("size_rad") is not None:
        size, std = (float(np.rad2deg(cause[name])) for name in ("size_rad", "size_std_rad"))
        return f"{number(size, 4, '+')} ± {number(std, 4)} deg"
    if cause.get("size_m") is None:
        return ""
    text = f"{mm(cause['size_m'])} ± {mm(cause['size_std_m'])} mm"
    if cause.get("turn_rad"):
        text += f", {number(float(np.rad2deg(cause['turn_rad'])), 3)} deg"
    return text


def _name(cause: Mapping[str, Any], t: Sentences, *, images: bool) -> str:
    """Name a cause as a user calls it."""
    code, name = cause["code"], cause["name"]
    if code == "joint":
        return t("cause_joint", name=name)
    if code == "row":
        image = cause.get("image")
        if image:
            return t("cause_image", name=image)
        return t("cause_row", rows=row_ranges(cause["rows"]))
    key = f"cause_{code}"
    if images and code == "frame":
        key = "cause_frame_camera"
    if images and code == "target":
        key = "cause_target_board"
    text = t(key)
    return t("cause_named", cause=text, name=name) if name else text
