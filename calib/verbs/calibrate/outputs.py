"""Files that ``calib calibrate`` writes, in every form."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from calib.cli.options import Accept, Force, TargetLink
from calib.cli.outputs import check_outputs
from calib.cli.terminal import command_line, progress_bar
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.result.calibration import Calibration


@dataclass(frozen=True, slots=True)
class Outputs:
    """Outputs of ``calib calibrate``."""

    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the corrected URDF.")
    ] = None
    json: Annotated[Path | None, typer.Option("--json", help="Write the whole result as JSON.")] = (
        None
    )
    view: Annotated[
        Path | None,
        typer.Option("--view", help="Write a page that shows both robots, to open in a browser."),
    ] = None
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FILE",
            help="Write a report with figures to print and sign: a page, .html.",
        ),
    ] = None
    figures: Annotated[
        Path | None,
        typer.Option(
            "--figures",
            metavar="FOLDER",
            help="Write every figure into this folder, and the captions as captions.md; the folder is made if missing.",
        ),
    ] = None
    figure_format: Annotated[
        Literal["png", "svg", "pdf"] | None,
        typer.Option("--figure-format", help="File format of --figures. Default: png."),
    ] = None
    target_link: TargetLink = False
    accept: Accept = False
    force: Force = False

    def check(self, inputs: Iterable[str | Path | None]) -> None:
        """Refuse outputs that cannot be written before the work begins.

        Args:
            inputs: The files that are read; None: not given.

        Raises:
            CalibError: See `check_outputs`; or options that do not go together.
        """
        if self.figures is None and self.figure_format is not None:
            raise CalibError("--figure-format takes --figures FOLDER.")
        if self.figures is not None and self.figures.is_file():
            raise CalibError(f"{self.figures} is a file; --figures names a folder.")
        if self.report is not None or self.figures is not None:
            from calib.show.plotting import require_matplotlib

            require_matplotlib("A report" if self.report is not None else "A figure")
        if self.report is not None:
            from calib.show.page import check_ending

            check_ending(self.report)
        files = (self.output, self.json, self.view, self.report)
        check_outputs(files, inputs, force=self.force)

    def write(
        self,
        result: Calibration,
        tables: Mapping[str, Any],
        *,
        quiet: bool,
    ) -> Iterator[Path | str]:
        """Write the outputs that were asked for, one after the other.

        The corrected URDF is not written if the verdict is ``do not use`` and was not accepted.

        Args:
            result: The calibration.
            tables: Further tables for the result file, by key.
            quiet: Whether no progress is shown.

        Yields:
            The name of each output, after it was written.
        """
        from calib.show.verdict import against

        if self.figures is not None and not self.force:
            from calib.verbs.calibrate.figures import drawings, figure_files

            # Figures that exist are refused before anything is written.
            figure_files(drawings(result), self.figures, self.figure_format or "png")
        if self.output is not None and (self.accept or not against(result.verdict)):
            yield result.write_urdf(
                self.output,
                overwrite=self.force,
                target_link=self.target_link,
                accept=self.accept,
            )
        if self.json is not None:
            from calib.result.calibration_file import write_result

            yield write_result(result, self.json, overwrite=self.force, extra=dict(tables))
        if self.view is not None:
            from calib.verbs.view.page import write_page

            yield write_page(result, self.view, overwrite=self.force, accepted=self.accept)
        if self.report is not None:
            from calib.verbs.calibrate.report import write_report

            command = command_line()
            yield write_report(result, self.report, command=command, overwrite=self.force)
        if self.figures is not None:
            from calib.verbs.calibrate.figures import write_figures

            with progress_bar("figures", quiet=quiet) as progress:
                figures = write_figures(
                    result,
                    self.figures,
                    kind=self.figure_format or "png",
                    overwrite=self.force,
                    progress=progress,
                )
            yield f"{self.figures} ({len(figures)} figures)"
