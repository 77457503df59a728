"""What ``calib calibrate`` computes and writes besides the calibration: intervals, and files in every form."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from calib.cli.options import Accept, Dask, Force, SampleWorkers, TargetLink
from calib.cli.setup import check_outputs
from calib.cli.terminal import command_line, progress_bar
from calib.errors import CalibError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from calib.calibration import Calibration


@dataclass(frozen=True, slots=True)
class Outputs:
    """What is written."""

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
            help="Write every figure into a folder, and their captions as captions.md; it is made if missing.",
        ),
    ] = None
    figure_format: Annotated[
        Literal["png", "svg", "pdf"] | None,
        typer.Option("--figure-format", help="The kind of file of --figures. Default: png."),
    ] = None
    target_link: TargetLink = False
    accept: Accept = False
    force: Force = False

    def check(self, inputs: list[str | Path]) -> None:
        """Refuse before the work what cannot be written after it."""
        if self.figures is None and self.figure_format is not None:
            raise CalibError("--figure-format takes --figures FOLDER.")
        if self.figures is not None and self.figures.is_file():
            raise CalibError(f"{self.figures} is a file; --figures names a folder.")
        if self.report is not None:
            from calib.report.report import check_ending

            check_ending(self.report)
        check_outputs((self.output, self.json, self.view, self.report), inputs, force=self.force)

    def write(
        self, result: Calibration, tables: dict[str, Any], *, quiet: bool
    ) -> Iterator[Path | str]:
        """Write what was asked for, one after the other; ``tables`` go into the result file too.

        The corrected URDF is left out where the verdict is ``do not use`` and was not accepted.
        """
        force, kind = self.force, self.figure_format or "png"
        if self.figures is not None and not force:
            from calib.report.figures import drawings, figure_files

            figure_files(drawings(result), self.figures, kind)
        from calib.text.verdict import against

        if self.output is not None and (self.accept or not against(result.verdict)):
            yield result.write_urdf(
                self.output, overwrite=force, target_link=self.target_link, accept=self.accept
            )
        if self.json is not None:
            from calib.result.calibration_file import write_result

            yield write_result(result, self.json, overwrite=force, extra=tables)
        if self.view is not None:
            from calib.viewer.page import write_page

            yield write_page(result, self.view, overwrite=force)
        if self.report is not None:
            from calib.report.report import write_report

            yield write_report(result, self.report, command=command_line(), overwrite=force)
        if self.figures is not None:
            from calib.report.figures import write_figures

            with progress_bar("figures", quiet=quiet) as progress:
                made = write_figures(
                    result, self.figures, kind=kind, overwrite=force, progress=progress
                )
            yield f"{self.figures} ({len(made)} figures)"


@dataclass(frozen=True, slots=True)
class Intervals:
    """Which intervals are computed beside those of the covariance."""

    bootstrap: Annotated[
        int | None,
        typer.Option(
            min=40,
            metavar="N",
            help="Fit again to N random samples of the poses, and print the intervals that follow; 1000 is a good "
            "number.",
        ),
    ] = None
    workers: SampleWorkers = None
    dask: Dask = None
    seed: Annotated[
        int | None,
        typer.Option(min=0, metavar="S", help="Seed of --bootstrap; the same S, the same samples."),
    ] = None
    profile: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PARAMETER",
            help="Print the interval of a parameter by the profile of the cost. Can be repeated.",
        ),
    ] = None

    def compute(
        self, result: Calibration, executor: Executor | None, *, quiet: bool
    ) -> tuple[list[str], dict[str, Any]]:
        """Bootstrap and profiles, as far as they are asked for: texts to print, and tables for the result file."""
        from calib.result.uncertainty import bootstrap, profile_interval
        from calib.text.summary import LEVEL, bootstrap_table, bootstrap_text, profile_text

        texts: list[str] = []
        tables: dict[str, Any] = {}
        if self.bootstrap is not None:
            with progress_bar("bootstrap", quiet=quiet) as progress:
                found = bootstrap(result, self.bootstrap, self.seed or 0, progress, executor)
            texts.append(bootstrap_text(result, found))
            tables["bootstrap"] = bootstrap_table(found)
        if self.profile:
            profiles = [
                (result.parameter(n), profile_interval(result, n, LEVEL)) for n in self.profile
            ]
            texts.append(profile_text(profiles))
            tables["profiles"] = [
                {"name": p.name, "unit": p.unit, **asdict(found)} for p, found in profiles
            ]
        return texts, tables
