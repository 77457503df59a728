"""``calib board``: a board to print, and the measured size of a print."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from calib.cli.options import Force, Quiet
from calib.cli.outputs import check_outputs
from calib.cli.verb import verb
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.boards.board import Board
    from calib.boards.board_design import Wish

#: Stem of the files where no output is named.
_OUTPUT = "board"


@dataclass(frozen=True, slots=True)
class DesignOptions:
    """Specification of a new board."""

    pattern: Annotated[
        Literal["charuco", "chessboard", "apriltag"] | None,
        typer.Option(
            help="charuco: a chessboard with markers, found even if partly hidden (default). chessboard: all of it "
            "must be seen. apriltag: a grid of tags."
        ),
    ] = None
    columns: Annotated[int | None, typer.Option(min=1, help="Squares, or tags, across.")] = None
    rows: Annotated[int | None, typer.Option(min=1, help="Squares, or tags, down.")] = None
    square: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help='Side of a square, or distance of tags, "30 mm". Default: as large as fits.',
        ),
    ] = None
    marker: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH", help="Side of a marker or tag. Default: as large as is found well."
        ),
    ] = None
    dictionary: Annotated[
        str | None,
        typer.Option(
            help="Dictionary of the markers. Default: DICT_5X5_100, or DICT_APRILTAG_36h11."
        ),
    ] = None
    first_marker: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Id of the first marker. Default: 0; boards in one picture need ids of their own.",
        ),
    ] = None
    legacy: Annotated[
        bool,
        typer.Option("--legacy", help="Lay out an even number of rows as OpenCV before 4.6 did."),
    ] = False

    def given(self) -> bool:
        """Return whether any of them is given."""
        return self != DesignOptions()

    def wish(self, name: str) -> Wish:
        """Return what is wanted, in SI units."""
        from calib.boards.board import CHARUCO
        from calib.boards.board_design import Wish

        return Wish(
            name=name,
            pattern=self.pattern or CHARUCO,
            columns=self.columns,
            rows=self.rows,
            square=_length(self.square, "--square"),
            marker=_length(self.marker, "--marker"),
            dictionary=self.dictionary,
            first_marker=self.first_marker or 0,
            legacy=self.legacy,
        )


def _length(text: str | None, option: str) -> float | None:
    """Read a length [m]; None stays None."""
    from calib.basics.units import LENGTH, parse_amount

    return None if text is None else parse_amount(text, option, LENGTH, "30 mm")


@verb("""Draw a board to print, true to scale, with its description.

\b
Examples:
  calib board                                        board.pdf, board.svg and board.toml, for A4
  calib board --paper letter -o left                 left.pdf and so on, named 'left'
  calib board --columns 12 --rows 9 --square "40 mm" --paper none
  calib board board.toml --measured "249.3 mm"       what the print measures, into board.toml
  calib board board.toml                             the PDF and SVG of a description
""")
def board(
    design: DesignOptions,
    description: Annotated[
        Path | None,
        typer.Argument(metavar="BOARD.toml", help="Description of a board that exists."),
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
    name: Annotated[
        str | None, typer.Option(help="Name of the board. Default: that of its files.")
    ] = None,
    measured: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH[/N]",
            help='What the print measures: the whole pattern across, "249.3 mm", or N squares, "99.7 mm / 4". Written '
            "into BOARD.toml.",
        ),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Run the verb; its help is the text of `verb`."""
    stem = _stem(output)
    if measured is not None:
        _refuse(
            design.given() or paper or output or name, "--measured", "a description, BOARD.toml"
        )
        lines = _measured(description, measured)
    elif description is not None:
        _refuse(design.given() or name, "BOARD.toml", "--paper, -o and --measured")
        lines = _redrawn(description, stem, paper, force=force)
    else:
        stem = stem or Path(_OUTPUT)
        lines = _designed(design.wish(name or stem.name), stem, paper or "a4", force=force)
    if not quiet:
        typer.echo("\n".join(lines))


def _refuse(others: object, option: str, allowed: str) -> None:
    """Refuse options that do not go with another one."""
    if others:
        raise CalibError(f"{option} goes with {allowed}, not with the options of a new board.")


def _stem(output: Path | None) -> Path | None:
    """Return the path of the outputs without an ending; 'board.pdf' means 'board'."""
    if output is not None and output.suffix.lower() in (".pdf", ".svg", ".toml"):
        return output.with_suffix("")
    return output


def _with_ending(stem: Path, ending: str) -> Path:
    """Append an ending to a path: 'v1.2' becomes 'v1.2.pdf'."""
    return stem.with_name(f"{stem.name}.{ending}")


def _designed(wish: Wish, stem: Path, paper: str, *, force: bool) -> list[str]:
    """Draw a new board and write its description."""
    from calib.boards.board_design import designed

    files = [_with_ending(stem, ending) for ending in ("pdf", "svg", "toml")]
    check_outputs(files, [], force=force)
    return _drawn(designed(wish, paper), files, paper, force=force)


def _redrawn(description: Path, stem: Path | None, paper: str | None, *, force: bool) -> list[str]:
    """Draw a board that is described, beside its description."""
    from calib.boards.board_file import read_board

    stem = stem or description.with_suffix("")
    files = [_with_ending(stem, ending) for ending in ("pdf", "svg")]
    board = read_board(description)
    check_outputs(files, [description], force=force)
    return _drawn(board, files, paper or "a4", force=force)


def _drawn(board: Board, files: list[Path], paper: str, *, force: bool) -> list[str]:
    """Draw a board on a paper and write the files."""
    from calib.basics.files import write_atomically
    from calib.boards.board_design import fitting_sheet
    from calib.boards.board_file import board_toml
    from calib.boards.page import page_of
    from calib.boards.page_files import WRITERS
    from calib.verbs.board.text import drawn_text, page_lines

    sheet = fitting_sheet(board, paper)
    page = page_of(board, sheet, page_lines(board))
    contents = {f".{ending}": write(page) for ending, write in WRITERS.items()}
    contents[".toml"] = board_toml(board).encode()
    for path in files:
        write_atomically(path, contents[path.suffix], overwrite=force)
    return drawn_text(board, sheet, paper, files)


def _measured(description: Path | None, measured: str) -> list[str]:
    """Write what a print measures into its description."""
    from calib.basics.files import read_bytes, write_atomically
    from calib.boards.board_file import read_board
    from calib.boards.print_scale import corrected_toml, print_scale, rescaled
    from calib.verbs.board.text import measured_text

    if description is None:
        raise CalibError(
            '--measured takes the description of the board: calib board board.toml --measured "249.3 mm"'
        )
    board = read_board(description)
    scale = print_scale(board, measured)
    corrected = rescaled(board, scale)
    text = read_bytes(description, "description of a board").decode("utf-8-sig")
    write_atomically(description, corrected_toml(text, corrected).encode(), overwrite=True)
    return measured_text(board, corrected, scale, description)
