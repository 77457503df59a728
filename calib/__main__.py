"""The program ``calib``, as ``python -m calib`` and the installed command start it.

Nothing heavy is imported before a verb runs, so that ``calib --help`` answers at once; and nothing at all before `main`
can say that it was interrupted.
"""

from __future__ import annotations

import io
import os
import sys

from calib.cli.exit_status import ExitStatus

__all__ = ["main"]


def main() -> None:
    """Run the ``calib`` command."""
    try:
        _run()
    except KeyboardInterrupt:  # before a verb runs, which says itself what stays of its work
        status = ExitStatus.INTERRUPTED
        message = "interrupted; no file was left half written."
    except OSError as error:  # a full disk behind `>`
        # What could not be printed must not be tried again at the end.
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115
        where = f"'{error.filename}'" if error.filename else "the printed text"
        status = ExitStatus.REFUSED
        message = f"{where} cannot be read or written: {error.strerror or error}."
    except SystemExit as end:
        if end.code != ExitStatus.INTERRUPTED:
            raise
        # Where Ctrl-C met an `exec`, as of a dataclass that is imported, Python would end by the signal in spite of it.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(ExitStatus.INTERRUPTED)
    else:
        return
    sys.stderr.write(f"calib: {message}\n")
    sys.exit(status)


def _run() -> None:
    """Prepare environment and streams, and run the program."""
    # The matrices are small: more threads gain nothing, and on a busy machine their waiting for each other takes ten
    # times as long as the work. NumPy reads this when it is imported, after this line; who sets it keeps it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A process that is started with a closed stream, as services are, has None there; the next file that it opens
    # would take the stream's place.
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
    # Pictures go into files, through no window: a window system that matplotlib lacks must not end a fit.
    os.environ["MPLBACKEND"] = "agg"
    for stream in (sys.stdout, sys.stderr):
        # A name that the terminal's encoding lacks is printed as an escape, not refused.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    from calib.program import app

    app(prog_name="calib")


if __name__ == "__main__":
    main()
