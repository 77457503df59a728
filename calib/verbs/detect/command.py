"""``calib detect``: the corners of printed boards in pictures, beside the joint values at which they were taken."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.executor import executor_of
from calib.cli.options import ColumnChoice, Columns, Force, Quiet, Workers
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import progress_bar
from calib.cli.verb import verb
from calib.errors import CalibError


@verb("""Find the corners of printed boards in pictures, and write them with the joint values of each picture.

\b
Examples:
  calib detect images --board board.toml --joints joints.csv -o corners.csv
  calib detect "run/*.png" --board board.toml --joints joints.csv --columns part=target -o corners.csv

Pictures are matched with rows by their names (column 'image') or their numbers (--index). Pictures that are not used
are listed with the reason; see also the contact sheet. If the board was moved between pictures, name its places in a
column 'target' of the table of joints.
""")
def detect(
    images: Annotated[
        list[str],
        typer.Argument(metavar="IMAGES...", help="Pictures (PNG, JPEG), folders, or patterns."),
    ],
    *,
    joints: Annotated[
        Path,
        typer.Option(
            metavar="TABLE",
            help="Table of joint values with a row for each picture, named in its column 'image'.",
        ),
    ],
    columns: Columns = None,
    index: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMN",
            help="Column with the numbers of the pictures (the last number in a file's name), instead of 'image'.",
        ),
    ] = None,
    board: Annotated[
        list[Path],
        typer.Option(
            metavar="FILE", help="Description of a board, from calib board. Can be repeated."
        ),
    ],
    camera_name: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=FOLDER]",
            help="Name of the camera that took the pictures, or those in FOLDER, or those whose names fit a pattern: "
            "cam1=cam1_*. Not needed if the table has a column 'group' or 'camera'. Can be repeated.",
        ),
    ] = None,
    fewest: Annotated[
        int,
        typer.Option(min=4, metavar="N", help="Do not use pictures with fewer corners of a board."),
    ] = 12,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Write the table of corners.")
    ],
    sheet: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the contact sheet, a page with all pictures and their corners. Default: next to the table, as "
            ".html.",
        ),
    ] = None,
    no_sheet: Annotated[bool, typer.Option("--no-sheet", help="Write no contact sheet.")] = False,
    force: Force = False,
    workers: Workers = None,
    quiet: Quiet = False,
) -> None:
    """Match pictures with rows, find the corners, write contact sheet and table, and print what was found."""
    from calib.basics.files import write_atomically
    from calib.boards.board_file import read_board
    from calib.boards.detection.detect import check_boards, detect as detect_boards
    from calib.boards.detection.picture import find_images
    from calib.show.as_html import check_ending
    from calib.verbs.detect.contact_sheet import write_contact_sheet
    from calib.verbs.detect.corner_table import corner_table, with_cameras, with_rows_only
    from calib.verbs.detect.matching import match, read_joint_table
    from calib.verbs.detect.text import detection_text

    if no_sheet and sheet is not None:
        raise CalibError(
            "--sheet names a contact sheet, and --no-sheet asks for none; leave one out."
        )
    page = None if no_sheet else sheet or output.with_suffix(".html")
    if page is not None:
        check_ending(page)
    check_outputs((output, page), [*board, joints], force=force)

    boards = [read_board(path) for path in board]
    check_boards(boards)
    options = ColumnChoice(columns).parsed()
    if options.brand is not None:
        raise CalibError(
            f"--columns {options.brand}: columns are copied as they are; name the brand to calib calibrate."
        )
    rows = read_joint_table(joints, options.names, index)
    # Names of cameras by folder or pattern, "" for all other pictures.
    cameras: dict[str, str] = {}
    for text in camera_name or ():
        name, _, folder = (part.strip() for part in text.partition("="))
        if not name or folder in cameras:
            raise CalibError(
                f'--camera-name was given \'{text}\'; it must be a name, "NAME=FOLDER" or "NAME=PATTERN", each '
                "folder or pattern once."
            )
        cameras[folder] = name
    files = find_images(images, cameras)
    matches = match(rows, files)
    with (
        executor_of(workers, None, len(files)) as executor,
        progress_bar("pictures", quiet=quiet) as progress,
    ):
        if progress is not None:
            progress(0, len(files))
        found = detect_boards(
            with_cameras(files, matches),
            boards,
            fewest=fewest,
            executor=executor,
            progress=progress,
        )
    detection = with_rows_only(found, matches)

    # The contact sheet shows why, even if no corner can be used.
    if page is not None:
        write_contact_sheet(detection, page, overwrite=force)
    lines = detection_text(detection, rows, matches)
    if not detection.corner_count:
        text = "\n".join([*lines, *written_lines(page)])
        raise CalibError(f"No corner can be used, so no table is written.\n{text}")
    write_atomically(output, corner_table(detection, rows, matches), overwrite=force)
    if not quiet:
        typer.echo("\n".join([*lines, *written_lines(output, page)]))
