"""A check in words: the answer first, then the causes, what it means, and what these poses would not have shown."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

import calib.data.kinds as registry
from calib.result.calibration import Calibration
from calib.show.lines import deg, listed, mm, number, paragraphs, plural, row_ranges
from calib.show.words import chain_name, joint_unit
from calib.verbs.check.check import CheckResult, Finding, Noticed
from calib.version import __version__

if TYPE_CHECKING:
    from calib.verbs.check.poses import CheckPoses

#: Causes with a smaller probability are not listed.
_LISTED = 0.005

#: A probability is not printed nearer to 1 than this: its digits mean nothing.
_NEAREST = 0.999


def answer(c: CheckResult) -> str:
    """Word the answer in a sentence."""
    if c.outcome == "nothing":
        return "Nothing has moved."
    best = c.findings[0]
    if c.outcome == "undecided":
        names = [f"{_name(c, finding)} (P {_probability(finding)})" for finding in c.named]
        return f"Something has moved: {' or '.join(names)}."
    if c.outcome == "row":
        return f"{_name(c, best).capitalize()} alone is off (P {_probability(best)}): measure it again."
    if c.outcome == "other":
        return "Something is off, and no single cause explains it."
    name = _name(c, best)
    return f"{name[0].upper()}{name[1:]} has moved: {_moved(best)} (P {_probability(best)})."


def check_text(c: CheckResult, more: CheckPoses | None = None) -> str:
    """Write the answer with the figures that it rests on, in lines of 100 columns.

    Args:
        c: The check.
        more: Poses that would decide between the causes; None: they were not sought, or are not needed.
    """
    result = c.result
    header = (
        f"calib {__version__}: check of {chain_name(result.nominal)}, run {result.run}, by {plural(c.stops, 'stop')} "
        f"with {c.numbers} numbers"
    )
    p = f"p = {c.p_value:.2g}" if c.p_value > 1e-4 else "p < 0.0001"
    ratio = (
        f"Measured minus predicted is {c.ratio:.2f} times what is expected if nothing has moved; so much evidence of a "
        f"cause would come by chance with {p}."
    )
    return paragraphs(
        [header], [answer(c), ratio], _causes(c), _meaning(c), _further(more), _noticed(c)
    )


def poses_text(poses: CheckPoses) -> str:
    """Say what poses to check at are worth."""
    (probability,) = poses.probabilities
    lines = [
        f"{plural(len(poses.joints), 'pose')} to check at: a cause that shows four standard deviations at a pose would "
        f"get a probability of {probability:.2f} on average."
    ]
    lines.append(_collisions(poses))
    return paragraphs([line for line in lines if line])


def _causes(c: CheckResult) -> Iterator[str]:
    """List the causes with their probabilities, if something is off."""
    if c.outcome == "nothing":
        return
    for finding in c.findings:
        if finding.probability < _LISTED:
            continue
        name = _name(c, finding)
        line = f"  P {_probability(finding)}  {name}: {_moved(finding)}"
        if finding.code == "joint":
            line += f"; positions by {mm(finding.change)} ± {mm(finding.change_std)} mm"
        yield line


def _meaning(c: CheckResult) -> Iterator[str]:
    """Say whether it matters, and what to do."""
    if not c.named or c.outcome in ("row", "other"):
        if c.outcome == "other":
            yield (
                "Look for a usual mistake (units, a column, the tool, the result of another robot) with calib evaluate "
                "--calibration, for another "
                "payload or temperature, and for several causes at once."
            )
        return
    best = c.named[0]
    allowed, what = (
        (c.expected, "the expected error")
        if c.tolerance is None
        else (c.tolerance, "the tolerance")
    )
    compared = "more" if c.matters else "no more"
    yield (
        f"Over the measured joint values it changes positions by {mm(best.change)} ± {mm(best.change_std)} mm rms, "
        f"{compared} than {what} of {mm(allowed)} mm."
    )
    if c.outcome != "moved":
        return
    if not c.matters:
        yield "It does not matter yet."
        return
    if best.code == "joint":
        yield "The robot's own calibration no longer holds: calibrate again."
    else:
        yield "The joint origins still hold. Find the place again: calib calibrate --model frames with fresh poses."


def _further(more: CheckPoses | None) -> Iterator[str]:
    """Say how many further poses would tell."""
    if more is None:
        return
    count, share = len(more.joints), more.probabilities[-1]
    if more.needed is not None:
        yield f"{plural(count, 'more pose')} would tell which, in {100 * share:.0f} of 100 cases."
    else:
        yield f"{plural(count, 'more pose')} would tell which in {100 * share:.0f} of 100 cases only."
    if text := _collisions(more):
        yield text


def _collisions(poses: CheckPoses) -> str:
    """Say that collisions were not checked; empty if they were."""
    if poses.collisions_checked:
        return ""
    return "Collisions were not checked, as the robot's shapes are not known: try the poses slowly."


def _noticed(c: CheckResult) -> Iterator[str]:
    """Say what these poses would have shown, and what they cannot show."""
    yield "These poses show in 95 of 100 checks, in the direction that they show least:"
    unseen = []
    for one in c.noticed:
        name = _name(c, one)
        factor, unit = joint_unit(prismatic=np.isnan(one.turn))
        sizes = []
        if one.code == "joint":
            size = one.shift if np.isnan(one.turn) else one.turn
            if np.isfinite(size):
                sizes.append(f"its zero by {number(factor * size)} {unit}")
            else:
                unseen.append(name)
        else:
            for kind, size, text in (
                ("shift", one.shift, f"{mm(one.shift)} mm"),
                ("turn", one.turn, f"{deg(one.turn)} deg"),
            ):
                if np.isfinite(size):
                    sizes.append(f"a {kind} of {text}")
                elif np.isinf(size):
                    unseen.append(f"every {kind} of {name}")
        if sizes:
            yield f"  {name}: {listed(sizes)}"
    if unseen:
        yield f"They cannot show {listed(unseen)}."


def _probability(finding: Finding) -> str:
    """Write a probability."""
    return f"> {_NEAREST}" if finding.probability > _NEAREST else f"= {finding.probability:.3f}"


def _moved(finding: Finding) -> str:
    """Say how far something has moved."""
    if finding.code == "joint":
        factor, unit = joint_unit(prismatic=finding.unit == "m")
        return f"its zero by {number(factor * finding.size, 4, '+')} ± {number(factor * finding.size_std, 4)} {unit}"
    text = f"the target by {mm(finding.size)} ± {mm(finding.size_std)} mm"
    if np.isfinite(finding.turn):
        text += f", turned by {deg(finding.turn)} deg"
    return text


def _name(c: CheckResult, one: Finding | Noticed) -> str:
    """Name a cause as a user calls it."""
    result = c.result
    if one.code == "joint":
        return f"joint '{one.name}'"
    if isinstance(one, Finding) and one.code == "row":
        return (
            f"image '{one.image}'"
            if one.image
            else f"row{'s' * (len(one.rows) > 1)} {row_ranges(one.rows)}"
        )
    if one.code == "other":
        return "all poses differently"
    if one.code == "base":
        return "the base"
    if one.code == "hand":
        return "what holds the targets"
    images = any(registry.get(kind).is_image for kind in result.rows.kinds)
    carried = result.nominal.base_moves
    named = f" '{one.name}'" if one.name else ""
    alone = one.code == "target" or len(result.setup.groups) > 1
    if one.code == "frame":
        what = ("camera" if images else instrument_word(result)) + named
        return (
            f"the {what}{' in the hand' * carried}"
            if carried or alone
            else f"the {what} or the base"
        )
    what = ("board" if images else "target") + named
    return f"the {what} or the base" if carried else f"the {what} in the hand"


def instrument_word(result: Calibration) -> str:
    """Return the word for what stands at a measurement frame: an artefact that defines it, or a tracker."""
    kinds = [registry.get(kind) for kind in dict.fromkeys(result.rows.kinds)]
    return "artefact" if any(kind.own_frame for kind in kinds) else "tracker"
