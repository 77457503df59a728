"""The report of a calibration: verdict first, then errors before and after, figures, parameters, and how it came about.

One HTML page, ``report.html.j2`` filled in: figures inside, no script, nothing from the network; it prints on A4.
"""

from __future__ import annotations

import base64
import os
import re
from collections import Counter
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import calib.report.report_tables as tables
import calib.text.summary as texts
from calib.data.kinds import get as kind_named
from calib.errors import FileError
from calib.estimate.statistics import interval_factor
from calib.files import write_atomically
from calib.result.calibration import Calibration
from calib.result.calibration_file import versions
from calib.result.verdict import Why
from calib.text.verdict import outside_text, reason_text, robustness_text

if TYPE_CHECKING:
    from calib.report.figures import Drawing

#: A drawing with more bytes than this as SVG goes in as PNG.
_LARGE = 260_000

#: A longer word in a table is broken anywhere: it would push its table off the page.
_LONGEST_WORD = 24

#: More targets, set-ups or combinations of parameters than this are counted.
_MOST = 40

#: The sign and the class of each verdict: a word and a sign, never a colour alone.
_VERDICTS = {
    "use": ("\N{CHECK MARK}", "good"),
    "use with care": ("!", "care"),
    "do not use": ("\N{MULTIPLICATION X}", "bad"),
    "none": ("\N{EN DASH}", "none"),
}

_PRIORS = {
    "data": "The sizes of the robot's errors (priors) were found from the data.",
    "given": "The sizes of the robot's errors (priors) were given.",
    "off": "No priors on the robot's errors.",
}


def write_report(
    calibration: Calibration, path: str | Path, *, command: str = "", overwrite: bool = False
) -> Path:
    """Write the report as a page.

    ``command`` made the calibration, as it was typed; empty where there was none.

    Raises:
        FileError: The name does not end in .html, the file exists, or it cannot be written.
    """
    check_ending(path)
    return write_atomically(path, report_bytes(calibration, command=command), overwrite=overwrite)


def check_ending(path: str | Path) -> None:
    """Refuse a name that does not end in .html or .htm."""
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise FileError(
            f"'{path}': a report is a page; let the name end in .html. The summary is its text."
        )


def report_bytes(calibration: Calibration, *, command: str = "") -> bytes:
    """The page, UTF-8. Nothing but its date, now or ``SOURCE_DATE_EPOCH``, differs between two of a calibration."""
    import jinja2

    from calib.report.figures import drawings

    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.tests["long"] = lambda text: any(len(w) > _LONGEST_WORD for w in text.split())
    source = (Path(__file__).parent / "report.html.j2").read_text(encoding="utf-8")
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    now = datetime.now(timezone.utc)
    when = datetime.fromtimestamp(int(epoch), timezone.utc) if epoch.isdecimal() else now
    content = _content(calibration, command, f"{when:%Y-%m-%d %H:%M} UTC")
    content["figures"] = [(one, _picture(one)) for one in drawings(calibration)]
    return environment.from_string(source).render(**content).encode("utf-8", "replace")


def _picture(drawing: Drawing) -> str:
    """The figure as a data address, lines as SVG and as PNG where that would be large."""
    from calib.report.figures import rendered

    media, data = "svg+xml", rendered(drawing, "svg")
    if len(data) > _LARGE:
        media, data = "png", rendered(drawing, "png")
    return f"data:image/{media};base64,{base64.b64encode(data).decode('ascii')}"


def _content(c: Calibration, command: str, date: str) -> dict[str, Any]:
    """What the template is filled with: texts, pairs of texts, and tables."""
    from markupsafe import Markup

    title = f"Calibration report: robot {c.nominal.name}"
    use = "none" if c.verdict is None else c.verdict.use
    # Of a text in CSS all but letters, digits and blanks are numbers, so that nothing ends it.
    footer = re.sub(r"[^A-Za-z0-9 ]", lambda found: f"\\{ord(found[0]):x} ", title[:80])
    m, v, said = c.measurements, c.cross_validation, texts.facts(c)
    chain = f"{c.nominal.name}, {c.nominal.base} to {c.nominal.tip}, {len(c.nominal.joints)} joints"
    estimated, source = f"{m.estimation.sum():,}", m.source or "from memory"
    without = int(np.sum(c.weights[m.estimation] <= 0.0))
    # What the measured poses cannot tell apart, and validation rows beyond the joint values that were fitted, where the
    # verdict does not name them.
    every = [str(one) for one in c.observability.unidentifiable]
    outside = outside_text(c.outside, np.array(m.rows)[m.validation].tolist())
    if c.verdict is not None and any(reason.why == Why.OUTSIDE for reason in c.verdict.reasons):
        outside = ""
    left_out = "No rows were left out in turn (no cross-validation), so there is no verdict."
    return {
        "c": c,
        "reasons": [reason_text(one) for one in (c.verdict.reasons if c.verdict else ())],
        "robustness_text": robustness_text,
        "title": title,
        "footer": Markup(f'"{footer}"'),
        "date": date,
        "heading": [
            ("Robot", chain),
            (
                "Measurements",
                f"{source}: {estimated} to estimate, {m.validation.sum():,} to validate",
            ),
            ("Date of the report", date),
        ],
        "verdict": (use, *_VERDICTS[use]),
        "tables": tables,
        "estimated": f"{estimated} estimation rows"
        + f", {without:,} of which have no weight" * bool(without),
        "factor": f"{interval_factor(c.fitted.estimate.freedom):.2f}",
        "errorless": bool(texts.errorless(c)),
        "places": [*texts.target_sentences(c, _MOST), *texts.frame_sentences(c, _MOST)],
        "weights": texts.weights_text(c),
        "rank": f"Rank: {said['Rank']}",
        "unidentifiable": texts.unidentifiable_text(c),
        "combinations": every[:_MOST] + [f"and {len(every) - _MOST} more"] * (len(every) > _MOST),
        "known_together": [
            f"{label}: {said[label]}" for label in (texts.TOGETHER, texts.SIZES) if label in said
        ],
        "measured": _measured(c, said),
        "outside": outside,
        "method": [
            f"{texts.solver_text(c)}. {c.solution.message}",
            f"Outliers {'have no' if c.fitted.task.robust else 'keep their'} weight in the fit.",
            left_out if v is None else f"Errors of left-out rows: {v.method}, {v.folds} fits.",
            _PRIORS[c.cell.priors.sizes],
        ],
        # What it takes to do it again.
        "trace": [
            ("Nominal robot", c.nominal.urdf.source or "from memory"),
            ("  SHA-256", c.nominal.urdf.sha256),
            ("Measurements", source),
            ("  SHA-256", m.sha256.replace(" + ", ", ") or "-"),
            ("Corrected robot", "as written without a target link"),
            ("  SHA-256", c.robot.urdf.sha256),
            ("Software", ", ".join(f"{name} {number}" for name, number in versions().items())),
            ("Command", command or "not from the command line"),
            ("Date of the report", date),
        ],
    }


def _measured(c: Calibration, said: dict[str, str]) -> list[tuple[str, str]]:
    """What was measured, and how well."""
    m = c.measurements
    rows = f"{m.estimation.sum():,} to estimate, {m.validation.sum():,} to validate (column 'set')"
    more = f"; {len(m.unmeasured):,} more without a measurement, left out" if m.unmeasured else ""
    kinds = [f"{kind_named(kind).words} ({n:,} rows)" for kind, n in Counter(m.kinds).items()]
    what = "one standard deviation of the target's position, from the covariance of the parameters"
    return [
        ("Rows", f"{len(m):,}: {rows}{more}"),
        ("Each row measures", "; ".join(kinds)),
        ("Noise of the rows", said["Noise"]),
        *((label, text) for label, text in said.items() if label == texts.SCATTER),
        (texts.EXPECTED, f"{said[texts.EXPECTED].removesuffix('.')}; {what}."),
    ]
