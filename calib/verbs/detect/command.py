"""``calib detect``: the corners of printed boards in pictures, beside the joint values at which they were taken."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.executor import executor_of
from calib.cli.options import ColumnChoice, Columns, Force, Quiet, Workers
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import progress_bar
from calib.cli.verb import verb
from calib.errors import CalibError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from calib.boards.board import Board
    from calib.boards.detection.detect import Detection
    from calib.verbs.detect.matching import JointTable, Matches


@dataclass(frozen=True, slots=True)
class JointRows:
    """The table of joint values, and how its rows are matched with pictures."""

    joints: Annotated[
        Path,
        typer.Option(
            metavar="TABLE",
            help="Table of joint values with a row for each picture, named in its column 'image'.",
        ),
    ]
    columns: Columns = None
    index: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMN",
            help="Column with the numbers of the pictures (the last number in a file's name), instead of 'image'.",
        ),
    ] = None

    def read(self) -> JointTable:
        """Read the table; raises `CalibError`."""
        from calib.verbs.detect.matching import read_joint_table

        options = ColumnChoice(self.columns).parsed()
        if options.brand is not None:
            raise CalibError(
                f"--columns {options.brand}: columns are copied as they are; name the brand to calib calibrate."
            )
        return read_joint_table(self.joints, options.names, self.index)


@dataclass(frozen=True, slots=True)
class BoardsAndCameras:
    """Boards that the pictures show, and cameras that took them."""

    board: Annotated[
        list[Path],
        typer.Option(
            metavar="FILE", help="Description of a board, from calib board. Can be repeated."
        ),
    ]
    camera_name: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=FOLDER]",
            help="Name of the camera that took the pictures, or those in FOLDER; not needed if the table has a column "
            "'group' or 'camera'. Can be repeated.",
        ),
    ] = None
    fewest: Annotated[
        int,
        typer.Option(min=4, metavar="N", help="Do not use pictures with fewer corners of a board."),
    ] = 12

    def boards(self) -> list[Board]:
        """Read the descriptions of the boards; raises `CalibError`."""
        from calib.boards.board_file import read_board

        return [read_board(path) for path in self.board]

    def cameras(self) -> Mapping[str, str]:
        """Return the names of cameras by folder, "" for all other pictures; raises `CalibError`."""
        cameras: dict[str, str] = {}
        for text in self.camera_name or ():
            name, _, folder = (part.strip() for part in text.partition("="))
            if not name or folder in cameras:
                raise CalibError(
                    f"--camera-name was given '{text}'; it must be a name, or \"NAME=FOLDER\", each folder once."
                )
            cameras[folder] = name
        return cameras


@dataclass(frozen=True, slots=True)
class DetectOutputs:
    """Files that are written."""

    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Write the table of corners.")
    ]
    sheet: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the contact sheet, a page with all pictures and their corners. Default: next to the table, as "
            ".html.",
        ),
    ] = None
    no_sheet: Annotated[bool, typer.Option("--no-sheet", help="Write no contact sheet.")] = False
    force: Force = False

    @property
    def page(self) -> Path | None:
        """The file of the contact sheet; None if none is wanted."""
        if self.no_sheet:
            return None
        return self.sheet or self.output.with_suffix(".html")

    def check(self, inputs: list[Path]) -> None:
        """Refuse, before the work begins, outputs that cannot be written; raises `CalibError`."""
        from calib.show.as_html import check_ending

        if self.no_sheet and self.sheet is not None:
            raise CalibError(
                "--sheet names a contact sheet, and --no-sheet asks for none; leave one out."
            )
        if self.page is not None:
            check_ending(self.page)
        check_outputs((self.output, self.page), inputs, force=self.force)

    def write(self, detection: Detection, joints: JointTable, matches: Matches) -> list[str]:
        """Write the contact sheet, then the table, and return the lines to print.

        Raises:
            CalibError: No corner can be used: the sheet is written, the table is not.
        """
        from calib.basics.files import write_atomically
        from calib.verbs.detect.contact_sheet import write_contact_sheet
        from calib.verbs.detect.corner_table import corner_table
        from calib.verbs.detect.text import detection_text

        if self.page is not None:
            write_contact_sheet(detection, self.page, overwrite=self.force)
        lines = detection_text(detection, joints, matches)
        if not detection.corner_count:
            text = "\n".join([*lines, *written_lines(self.page)])
            raise CalibError(f"No corner can be used, so no table is written.\n{text}")
        table = corner_table(detection, joints, matches)
        write_atomically(self.output, table, overwrite=self.force)
        return [*lines, *written_lines(self.output, self.page)]


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
    rows: JointRows,
    seen: BoardsAndCameras,
    outputs: DetectOutputs,
    workers: Workers = None,
    quiet: Quiet = False,
) -> None:
    """Run the verb; its help is the text of `verb`."""
    from calib.boards.detection.detect import check_boards, detect as detect_boards
    from calib.boards.detection.picture import find_images
    from calib.verbs.detect.corner_table import with_cameras, with_rows_only
    from calib.verbs.detect.matching import match

    outputs.check([*seen.board, rows.joints])
    boards = seen.boards()
    check_boards(boards)
    joints = rows.read()
    files = find_images(images, seen.cameras())
    matches = match(joints, files)
    with (
        executor_of(workers, None, len(files)) as executor,
        progress_bar("pictures", quiet=quiet) as progress,
    ):
        detection = detect_boards(
            with_cameras(files, matches),
            boards,
            fewest=seen.fewest,
            executor=executor,
            progress=progress,
        )
    lines = outputs.write(with_rows_only(detection, matches), joints, matches)
    if not quiet:
        typer.echo("\n".join(lines))
