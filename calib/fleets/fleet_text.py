"""What ``calib fleet`` prints: a row for each robot, the odd ones, the failed ones, and how many there were."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from calib.fleets.fleet import Fleet
from calib.fleets.record import STALE
from calib.text.lines import fill

#: More robots than this are counted, and those are listed that need somebody to look at them.
LISTED = 40

#: What `Odd.figure` says of data that are another robot's too.
DATA = "data"


def fleet_cells(found: Fleet) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the table of robots; of a large fleet those that are odd or not simply to be used."""
    shown = [row for row in found.rows if row not in found.failed]
    if len(shown) > LISTED:
        odd = {one.name for one in found.odd}
        shown = [row for row in shown if row.name in odd or row.verdict not in ("use", "")]
    sizes = {
        "nominal": "nominal_rms",
        "calibrated": "calibrated_rms",
        "unseen": "unseen_rms",
    }
    # Behind "unseen" where that is of validation rows: what robots are compared by.
    if any(row.unseen == "validation" and row.left_out_rms == row.left_out_rms for row in shown):
        sizes["cross-val."] = "left_out_rms"
    sizes["noise"] = "sigma"
    heads = ["robot", "verdict", "model", *sizes, "rows", "out"]
    rows = []
    for row in shown:
        numbers = [getattr(row, name) for name in sizes.values()]
        model = f"{row.model} ({row.larger})" if row.larger else row.model
        cells = ["" if value != value else f"{1e3 * value:.3f}" for value in numbers]
        rows.append([row.name, row.verdict or "-", model, *cells, str(row.rows), str(row.outliers)])
    return heads, rows


def fleet_text(found: Fleet) -> Iterator[str]:
    """The odd ones, the failed ones, what could not be said, and how many there were."""
    odd: dict[str, list[str]] = {}
    twice: dict[str, list[str]] = {}
    failed: dict[str, list[str]] = {}
    for one in found.odd:
        (twice if one.figure == DATA else odd).setdefault(one.name, []).append(one.text)
    for row in found.failed:
        kept = " The folder holds the result of earlier inputs." * (row.status == STALE)
        failed.setdefault(f"{row.message.removesuffix('.')}.{kept}", []).append(row.name)
    for head, lines in (
        ("Odd ones out:", [f"{name}: {'; '.join(texts)}" for name, texts in odd.items()]),
        (
            "Data given twice, which count once in what is usual:",
            [f"{name}: {'; '.join(texts)}" for name, texts in twice.items()],
        ),
        ("Failed:", [f"{', '.join(names)}: {text}" for text, names in failed.items()]),
    ):
        if lines:
            yield "\n".join([head, *(fill(line, "  ", "  ") for line in lines), ""])
    for note in found.notes:
        yield fill(note)
    done = [row for row in found.rows if row not in found.failed]
    verdicts = Counter(row.verdict or "no verdict" for row in done)
    words = ", ".join(f"{count} {word}" for word, count in verdicts.most_common())
    yield (
        f"{len(done)} of {len(found.rows)} robots calibrated"
        + f" ({words})" * bool(words)
        + f", {found.kept} of them by an earlier run" * bool(found.kept)
        + f"; {len(odd)} odd"
        + f", {len(twice)} with the data of another" * bool(twice)
        + f", {len(found.failed)} failed."
    )
