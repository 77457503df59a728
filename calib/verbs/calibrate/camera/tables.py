"""Tables of image errors: in the image [px], and beside it what they are at the board [mm]."""

from __future__ import annotations

from calib.numerics.errors import Errors, UnitErrors
from calib.result.calibration import Calibration
from calib.show.table import Table
from calib.verbs.calibrate.camera.of_calibration import all_pixels_are_images
from calib.verbs.calibrate.tables import error_cells, figures_by_label
from calib.verbs.calibrate.text import errors_at_board, held_out_text

#: Sets of rows on a first page, by their labels in `errors_at_board`; the first ones that there are.
_FIRST_PAGE = (("validation rows", "held-out rows*"), ("estimation rows",))


def image_errors(c: Calibration) -> Table:
    """Tabulate the errors of each set of rows in the image, and beside them at the board; no rows without images."""
    at_board = errors_at_board(c)
    rows: list[tuple[str, ...]] = []
    strong: list[int] = []
    for label, figures in figures_by_label(c, "px").items() if at_board else ():
        if ", calibrated" in label:
            strong.append(len(rows))
        at = _metres(at_board, label)
        cells = error_cells(at) if at is not None else ["-"] * 3
        rows.append((label, f"{figures.n:,}", *error_cells(figures), *cells))
    notes = [f"{held_out_text(c)}."] if c.cross_validation is not None else []
    notes.append(
        "An error at the board is that in the image times the corner's distance along the camera's axis over the focal "
        "length: across the line of sight."
    )
    return Table(
        "Errors of corners by set of rows, in the image [px] and at the board [mm]",
        ("rows, robot", "number", *2 * ("max", "mean", "rms")),
        rows,
        "l" + "r" * 7,
        " ".join(notes),
        (("", 2), ("in the image [px]", 3), ("at the board [mm]", 3)),
        strong,
    )


def units_of_tables(c: Calibration) -> tuple[str, ...]:
    """Return the units of which a table of errors is needed: not of pixels where `image_errors` has all of them."""
    of_images = c.rows.metres_per_pixel is not None and all_pixels_are_images(c)
    return tuple(unit for unit in c.rows.channels.present if not (unit == "px" and of_images))


def with_errors_at_board(table: Table, c: Calibration) -> Table:
    """Return the table of a first page with the errors at the board below those in the image; see `before_and_after`.

    Args:
        table: `calib.verbs.calibrate.tables.before_and_after` of the calibration.
        c: The result.
    """
    rows = [*table.rows]
    at_board = errors_at_board(c)
    name = "position at the board [mm]"
    for labels in _FIRST_PAGE:
        for label in labels:
            before = _metres(at_board, f"{label}, nominal")
            after = _metres(at_board, f"{label}, calibrated")
            if before is not None and after is not None:
                cells = (*error_cells(before), *error_cells(after))
                rows.append((name, label.rstrip("*"), f"{after.n:,}", *cells))
                name = ""
        if len(rows) > len(table.rows):
            break
    return table._replace(rows=rows)


def _metres(at_board: dict[str, Errors], label: str) -> UnitErrors | None:
    """Return the errors at the board of a set of rows; None where there are none."""
    errors = at_board.get(label)
    if errors is None or not errors["m"].n:
        return None
    return errors["m"]
