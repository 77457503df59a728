"""A result made again, in words: whether it is equal, what was not as before, and what moved by how much."""

from __future__ import annotations

from collections.abc import Iterator

from calib.errors import choices
from calib.show.lines import fill, paragraphs, plural
from calib.show.words import before_and_after, rms_text
from calib.verbs.calibrate.again import Again, Change, What

#: Parameters that are listed; the others moved less.
_LISTED = 5

#: Digits of a hash that are shown.
_DIGITS = 12

#: What a package or a part of the machine is called.
_PACKAGES = {"pin": "Pinocchio", "blas": "linear algebra (BLAS)", "cpu": "processor"}


def again_text(a: Again) -> str:
    """Write whether a result that was made again is equal to the first one, and what differs."""
    return paragraphs([fill(answer(a))], _changes(a), _numbers(a))


def answer(a: Again) -> str:
    """Say in one sentence whether the result is equal."""
    if a.is_equal:
        return f"Made again: equal to the last bit, {plural(a.compared, 'value')} and the corrected URDF."
    count = f"{len(a.differences):,} of {plural(a.compared, 'value')}"
    urdf = "the same bytes" if a.has_same_urdf else "other bytes"
    return f"Made again: not equal. {count} differ; the corrected URDF has {urdf}."


def _changes(a: Again) -> Iterator[str]:
    """List the inputs, plugins, options and versions that are not as before."""
    for change in a.changes:
        yield fill(_change_text(change), "  ", "  ")


def _change_text(change: Change) -> str:
    """Describe something that is not as before."""
    name = _PACKAGES.get(change.name, change.name)
    if change.what is What.OPTION:
        return f"option {name}: {change.before or 'by default'}, now {change.now or 'by default'}"
    if change.what is What.VERSION:
        return f"{name}: {change.before or 'not recorded'}, now {change.now or 'none'}"
    word = "input" if change.what is What.INPUT else "plugin"
    before, now = (text[:_DIGITS] or "none" for text in (change.before, change.now))
    return f"{word} '{name}' has changed: SHA-256 {before}, now {now}"


def _numbers(a: Again) -> Iterator[str]:
    """Say by how much parameters and errors moved, and whether the verdict is the same."""
    if a.is_equal:
        return
    moved = a.moved
    if moved:
        farthest = [f"{pair.before.name} by {pair.in_std:.2g}" for pair in moved[:_LISTED]]
        text = f"Parameters that moved, in their standard deviations: {', '.join(farthest)}"
        text += f"; {len(moved) - _LISTED} others by less." if len(moved) > _LISTED else "."
        yield fill(text)
    names = [{each.name for each in result.parameters} for result in (a.before, a.result)]
    for words, only in (("before", names[0] - names[1]), ("now", names[1] - names[0])):
        if only:
            yield fill(f"Parameters only {words}: {choices(sorted(only))}.")
    (where, _, before), (_, _, now) = before_and_after(a.before), before_and_after(a.result)
    yield fill(
        f"Rms error of the calibrated robot, {where}: {rms_text(before)}, now {rms_text(now)}."
    )
    verdicts = ["none" if r.verdict is None else r.verdict.use for r in (a.before, a.result)]
    same = "the same" if verdicts[0] == verdicts[1] else f"{verdicts[0]}, now {verdicts[1]}"
    yield fill(f"Verdict: {same}.")
