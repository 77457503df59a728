"""Texts that `calib detect` prints: corners found, pictures not used and why, findings about boards and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calib.boards.board import CHARUCO, CHESSBOARD, Board
from calib.boards.detection.board_findings import Finding
from calib.boards.detection.detect import Detection
from calib.boards.detection.picture import Picture
from calib.show.lines import fill, number, plural
from calib.verbs.detect.matching import JointTable, Matches

#: Largest number of names in a line; the others are counted.
_MOST_NAMES = 6

#: Why nothing of a picture is used, if the picture itself is the reason.
_REASONS = {
    "unreadable": "the file is not a picture, or is damaged",
    "other_size": "{width} x {height} pixels, unlike most pictures of this camera; its intrinsics do not apply",
    "no_row": "no row of the table of joints belongs to it",
}

#: Why a board is not used in a picture.
_VIEW_REASONS = {
    "no_board": "no board in it",
    "blurred": "blurred; wait until the arm stands still, focus, or add light",
    "flat": "hardly any contrast: no light, a cap on the lens, or nothing but a wall",
    "overexposed": "overexposed: more than half of it is at the highest grey value; expose it less",
    "mirrored": "a mirror image: the board is found only if the picture is flipped",
    "cut": "{count} of the {wanted} corners needed; the board extends beyond the picture",
    "few_corners": "{count} of the {wanted} corners needed; the others are hidden, too small, or badly lit",
    "layout": "not the board that is described",
    "two_boards": "it shows two boards with the same markers; cover one, or print other markers",
}

#: The sentence of each finding.
_FINDINGS = {
    "swapped": "{Board}columns and rows are swapped: the print has {columns} columns and {rows} rows{layout}. Correct "
    "the description.",
    "legacy": "{Board}the print has the {layout_name} layout of ChArUco boards, not the one described. Write "
    'layout = "{layout_name}" in the description.',
    "size": "{Board}the print has {columns} columns and {at_least}{rows} rows{layout}, not {old_columns} and "
    "{old_rows}. Write columns = {columns} and rows = {rows} in its description.",
    "inner_corners": "{Board}{old_columns} and {old_rows} are the numbers of inner corners of the print. Count "
    "squares: write columns = {columns} and rows = {rows} in its description.",
    "ratio": "{Board}the markers measure {value} of a square, the description says {old_value}. Measure square and "
    "marker on the print: is it this board?",
    "first_marker": "{Board}the first marker has the id {first}, the description says {old_first}. Correct the "
    "description.",
    "dictionary": "{Board}the markers are from {dictionary}, or a larger dictionary with as many bits, not from "
    "{old_dictionary}. Correct the description.",
    "mirrored": "{Board}it is found only in mirrored pictures: the print is a mirror image, or the camera's driver "
    "flips its pictures. Turn that off, or print the board again.",
    "two_boards": "{Board}two boards with the same markers are in one picture. Cover one, or print it with other "
    "markers.",
    "unexplained": "{Board}the markers are not where the description has them, and neither swapped columns and rows "
    "nor another layout, size or ratio of marker and square explains it. Is it a flat print of this board?",
    "ambiguous": "{Board}it looks the same after half a turn ({columns} columns and {rows} rows), and a picture does "
    "not show which end is the first. In each picture the x axis is taken to point right; calib calibrate decides by "
    "the robot which end it is. A chessboard of one column less, or a board with markers, shows it.",
    "more_markers": "{Board}the print has more rows than the {old_rows} described. Correct the description, so that "
    "the other corners are used too.",
    "unseen_row": "{Board}no picture shows a marker of the last row described: does the print have {old_rows} rows?",
    "smaller": "{Board}soft pictures: it is seen in smaller copies of them only. Its corners are used, less precisely; "
    "focus, and wait until the arm stands still.",
    "evened": "{Board}dark or unevenly lit: it is seen only with their brightness evened out. Its corners are used, "
    "less precisely; add light, or expose longer.",
    "negative": "{Board}it is seen only in the negative of the pictures: the print is white on black.",
    "other_size": "Pictures whose size differs from that of most pictures of their camera are not used: take all at "
    "one resolution.",
    "same_picture": "Some pictures are identical to the last bit: did the camera deliver an old frame?",
}


def detection_text(detection: Detection, joints: JointTable, matches: Matches) -> list[str]:
    """Write corners found, pictures not used, rows without a picture, and findings.

    Args:
        detection: The corners, and the pictures that they are in.
        joints: The table of joints.
        matches: The row of each picture, and the rows without a picture.

    Returns:
        Lines of at most 100 columns, except for long names.
    """
    lines = [fill(summary(detection))]
    lines += [fill(line, "  ", "  ") for line in _boards_text(detection)]
    left_out = not_used(detection)
    if left_out:
        lines += ["", "Not used:"]
        lines += [fill(f"- {name}: {reason}.", "", "  ") for name, reason in left_out]
    if matches.unmatched:
        names = []
        for row in matches.unmatched:
            cell = joints.cell(row, joints.image or joints.index)
            names.append(f"{cell} (line {joints.table.lines[row]})")
        rows = f"{plural(len(names), 'row')} of {joints.table.source}"
        lines += ["", fill(f"Without a picture: {rows}: {_first_names(names)}.")]
    if detection.findings:
        lines += ["", "Findings:"]
        lines += [fill(f"- {text}", "", "  ") for text in findings_text(detection)]
    return lines


def summary(detection: Detection) -> str:
    """Write how many corners there are in how many pictures, in one sentence."""
    used = len(detection.used)
    count = plural(len(detection.pictures), "picture")
    return f"{plural(detection.corner_count, 'corner')} in {used} of {count}."


def not_used(detection: Detection) -> list[tuple[str, str]]:
    """Return names of the pictures of which no corner is used, each with the reason in words."""
    return [
        (picture.file.name, reason_text(picture, detection.fewest))
        for picture in detection.pictures
        if not picture.used
    ]


def reason_text(picture: Picture, fewest: int) -> str:
    """Write why nothing of a picture is used: a reason of the picture, else that of each board in it.

    Args:
        picture: The picture.
        fewest: Fewest corners with which a picture is used.
    """
    if picture.reason:
        width, height = picture.size
        return _REASONS[picture.reason].format(width=width, height=height)
    reasons = []
    several = len(picture.views) > 1
    for view in picture.views:
        text = _VIEW_REASONS[view.reason].format(count=len(view.ids), wanted=fewest)
        reasons.append(f"{view.board}: {text}" if several else text)
    return "; ".join(reasons)


def findings_text(detection: Detection) -> list[str]:
    """Write each finding as sentences, with the pictures that show it."""
    boards = {board.name: board for board in detection.boards}
    texts = []
    for finding in detection.findings:
        sentence = _sentence(finding, boards.get(finding.board))
        pictures = f" ({_first_names(finding.pictures)})" if finding.pictures else ""
        texts.append(f"{sentence}{pictures}")
    return texts


def _boards_text(detection: Detection) -> Iterator[str]:
    """Yield a line for each board: how many of its corners the pictures show, and how precisely [px]."""
    for board in detection.boards:
        views = []
        for picture in detection.used:
            views += [view for view in picture.used if view.board == board.name]
        if not views:
            yield f"{board.name}: not found."
            continue
        counts = [len(view.ids) for view in views]
        fewest, most = min(counts), max(counts)
        found = str(most) if fewest == most else f"{fewest} to {most}"
        sigma = float(np.median(np.concatenate([view.sigma for view in views])))
        total = len(board.corners)
        yield (
            f"{board.name}: {found} of {total} corners in {plural(len(views), 'picture')}, "
            f"sigma {number(sigma)} px (median)."
        )


def _first_names(names: Sequence[str]) -> str:
    """List names in one text; of many the first, and how many more there are."""
    shown = ", ".join(names[:_MOST_NAMES])
    more = len(names) - _MOST_NAMES
    return f"{shown} and {more} more" if more > 0 else shown


def _sentence(finding: Finding, board: Board | None) -> str:
    """Write the sentence of a finding about a board, or if there is no board (None) about pictures as a whole."""
    template = _FINDINGS[finding.code]
    if board is None:
        return template
    better = finding.better or board
    has_layouts = better.pattern == CHARUCO and better.rows % 2 == 0
    layout_name = "legacy" if better.legacy else "new"
    return template.format(
        Board=f"Board '{board.name}': ",
        columns=better.columns,
        rows=better.rows,
        layout=f", in the {layout_name} layout" if has_layouts else "",
        layout_name=layout_name,
        # The last row of markers may be hidden in all pictures; a chessboard is seen as a whole.
        at_least="" if better.pattern == CHESSBOARD else "at least ",
        old_columns=board.columns,
        old_rows=board.rows,
        value=number(finding.value),
        old_value=number(board.marker / board.square),
        first=better.first_marker,
        old_first=board.first_marker,
        dictionary=finding.dictionary,
        old_dictionary=board.dictionary,
    )
