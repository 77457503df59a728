"""Intervals of ``calib calibrate`` beside those of the covariance: bootstrap and profile."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.cli.options import Dask
from calib.cli.terminal import progress_bar
from calib.errors import CalibError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from calib.result.calibration import Calibration


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals that are computed beside those of the covariance."""

    bootstrap: Annotated[
        int | None,
        typer.Option(
            min=40,
            metavar="N",
            help="Fit to this number of random samples of the poses, and print the resulting intervals; 1000 is a good "
            "number.",
        ),
    ] = None
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Number of processes that share the samples of --bootstrap. Default: one.",
        ),
    ] = None
    dask: Dask = None
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="S",
            help="Seed of the samples of --bootstrap; the same seed gives the same samples.",
        ),
    ] = None
    profile: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PARAMETER",
            help="Print the profile-likelihood interval of this parameter. Can be repeated.",
        ),
    ] = None

    def check(self) -> None:
        """Refuse options of the bootstrap without it; raises `CalibError`."""
        if self.bootstrap is not None:
            return
        for option in ("seed", "workers", "dask"):
            if getattr(self, option) is not None:
                raise CalibError(
                    f"--{option} is for the samples of --bootstrap; give their number, such as "
                    "--bootstrap 1000."
                )

    def compute(
        self,
        result: Calibration,
        executor: Executor | None,
        *,
        quiet: bool,
    ) -> tuple[list[str], dict[str, Any]]:
        """Compute the intervals that were asked for.

        Args:
            result: The calibration.
            executor: Runs the samples of the bootstrap; None: this process.
            quiet: Whether no progress is shown.

        Returns:
            Texts to print, and tables for the result file by key.
        """
        from calib.verbs.calibrate.report import bootstrap_text, profile_text
        from calib.verbs.calibrate.uncertainty import LEVEL, bootstrap, profile_interval

        texts: list[str] = []
        tables: dict[str, Any] = {}
        if self.bootstrap is not None:
            with progress_bar("bootstrap", quiet=quiet) as progress:
                samples = bootstrap(result, self.bootstrap, self.seed or 0, progress, executor)
            texts.append(bootstrap_text(result, samples))
            tables["bootstrap"] = samples.table()
        if self.profile:
            profiles = [
                (result.parameter(name), profile_interval(result, name, LEVEL))
                for name in self.profile
            ]
            texts.append(profile_text(profiles))
            tables["profiles"] = [
                {"name": parameter.name, "unit": parameter.unit, **asdict(interval)}
                for parameter, interval in profiles
            ]
        return texts, tables
