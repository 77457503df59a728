"""``calib board``: a board to print, and the measured size of a print."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from calib.basics.records import changes
from calib.boards.board import Board
from calib.cli.options import Force, Quiet, field_parameters
from calib.cli.output_files import check_outputs
from calib.cli.verb import verb
from calib.errors import CalibError

#: Stem of the files if no output is named.
_OUTPUT = "board"


@dataclass(frozen=True, slots=True)
class DesignOptions:
    """The options that the fields of `Board` declare."""

    #: What was typed, by the names of the options that were given.
    given: Mapping[str, Any]

    @classmethod
    def parameters(cls) -> list[inspect.Parameter]:
        """Return the options as parameters of a function, of which typer makes options."""
        return field_parameters(Board)

    @classmethod
    def of_typed(cls, typed: Mapping[str, Any]) -> DesignOptions:
        """Return the options that were given: of the values by name those that are neither None nor False."""
        return cls(
            {
                name: value
                for name, value in typed.items()
                if value is not None and value is not False
            }
        )


@verb("""Draw a board to print, true to scale, with its description.

\b
Examples:
  calib board                                        board.pdf, board.svg and board.toml, for A4
  calib board --paper letter -o left                 left.pdf and so on, of a board named 'left'
  calib board --columns 12 --rows 9 --square "40 mm" --paper none
  calib board board.toml --measured "249.3 mm"       write what the print measures into board.toml
  calib board board.toml                             the PDF and SVG of a description
""")
def board(
    design_options: DesignOptions,
    description: Annotated[
        Path | None,
        typer.Argument(metavar="BOARD.toml", help="Description of an existing board."),
    ] = None,
    paper: Annotated[
        str | None,
        typer.Option(
            metavar="a4|a3|letter|none",
            help="Paper; none: a sheet as large as needed. Default: a4.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="NAME",
            help="Write NAME.pdf, NAME.svg, NAME.toml. Default: board.",
        ),
    ] = None,
    measured: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH[/N]",
            help='Size measured on the print: the whole pattern across, "249.3 mm", or N squares, "99.7 mm / 4". '
            "Written into BOARD.toml.",
        ),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Draw a board, new or described, or write what its print measures.

    Options that go with another of these three raise `CalibError`.
    """
    given = design_options.given
    stem = output
    if output is not None and output.suffix.lower() in (".pdf", ".svg", ".toml"):
        stem = output.with_suffix("")
    if measured is not None:
        _refuse(given or paper or output, "--measured", "a description, BOARD.toml")
        lines = _measure(description, measured)
    elif description is not None:
        _refuse(given, "BOARD.toml", "--paper, -o and --measured")
        lines = _redraw(description, stem, paper or "a4", force=force)
    else:
        lines = _design(given, stem or Path(_OUTPUT), paper or "a4", force=force)
    if not quiet:
        typer.echo("\n".join(lines))


def _refuse(others: object, option: str, allowed: str) -> None:
    """Refuse options that do not go with another one."""
    if others:
        raise CalibError(f"{option} goes with {allowed}, not with the options of a new board.")


def _files(stem: Path, *endings: str) -> list[Path]:
    """Return the files with a stem: 'v1.2' is that of 'v1.2.pdf'."""
    return [stem.with_name(f"{stem.name}.{ending}") for ending in endings]


def _design(given: Mapping[str, Any], stem: Path, paper: str, *, force: bool) -> list[str]:
    """Draw a new board, by the options as typed, write it with its description, and return lines to print."""
    from calib.boards.board_design import design

    values = {"name": stem.name, **changes(Board, given)}
    files = _files(stem, "pdf", "svg", "toml")
    check_outputs(files, [], force=force)
    return _draw(design(paper, **values), files, paper, force=force)


def _redraw(description: Path, stem: Path | None, paper: str, *, force: bool) -> list[str]:
    """Draw a board by its description, write it as PDF and SVG, and return lines to print.

    Without a stem the files are named as the description.
    """
    from calib.boards.board_file import read_board

    files = _files(stem or description.with_suffix(""), "pdf", "svg")
    board = read_board(description)
    check_outputs(files, [description], force=force)
    return _draw(board, files, paper, force=force)


def _draw(board: Board, files: list[Path], paper: str, *, force: bool) -> list[str]:
    """Draw a board on a paper, write it into the files, each by its ending, and return lines to print."""
    from calib.basics.files import write_atomically
    from calib.boards.board_design import fitting_sheet
    from calib.boards.board_file import board_toml
    from calib.boards.board_page import WRITERS, page_of
    from calib.verbs.board.text import drawn_text, page_lines

    sheet = fitting_sheet(board, paper)
    page = page_of(board, sheet, page_lines(board))
    contents = {f".{ending}": write(page) for ending, write in WRITERS.items()}
    contents[".toml"] = board_toml(board).encode()
    for path in files:
        write_atomically(path, contents[path.suffix], overwrite=force)
    return drawn_text(board, sheet, paper, files)


def _measure(description: Path | None, measured: str) -> list[str]:
    """Write what a print measures, a length as typed, into its description, and return lines to print.

    It raises `CalibError` without a description, and for another text.
    """
    from calib.basics.files import read_bytes, write_atomically
    from calib.boards.board_file import correct_toml, read_board
    from calib.boards.printed import print_scale, rescaled
    from calib.verbs.board.text import measured_text

    if description is None:
        raise CalibError(
            '--measured takes the description of the board: calib board board.toml --measured "249.3 mm"'
        )
    if description.suffix.lower() != ".toml":
        raise CalibError(
            f"--measured corrects a description of calib, a TOML file, and not '{description}'. Correct the lengths in "
            "that file by hand."
        )
    board = read_board(description)
    scale = print_scale(board, measured)
    corrected = rescaled(board, scale)
    text = read_bytes(description, "description of a board").decode("utf-8-sig")
    write_atomically(description, correct_toml(text, corrected).encode(), overwrite=True)
    return measured_text(board, corrected, scale, description)
