"""A calibration in words: its rows, noise, outliers and parameters, and how it was solved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.basics.values import one_line
from calib.fit.registration.rows import USUAL_POSE_NOISE
from calib.fit.selection.row_weights import Robustness
from calib.model.error_model import FRAME, TARGET
from calib.model.families import FAMILIES
from calib.numerics.correlated_noise import PoseNoise
from calib.result.board_errors import BoardErrors
from calib.result.calibration import ENOUGH_FREEDOM, Calibration
from calib.result.fitted_model import ParameterEstimate
from calib.result.parts import Outlier
from calib.show.error_tables import measured_lengths
from calib.show.lines import listed, mm, plural
from calib.show.words import before_and_after, chain_name, rms_text, shown, with_unit

#: A part whose share of an rms error is above this makes more than half of its square.
_MOSTLY = 0.71

#: Outliers, or their images, that are listed; the others are counted.
_LISTED = 12

#: Why the accuracy of a result is not known, by `Calibration.unknown_accuracy`.
_UNKNOWN = {
    "verdict": "see the verdict",
    "rows": "too few rows",
    "stops": "end stops tell nothing of lengths",
}

#: A prior standard deviation below this is shown as none [mm, mrad, urad/Nm]: the last digit shown.
_NOTHING = 2e-3

#: Labels of `facts` that tests and the report ask for.
EXPECTED = "Expected error at a new point"
POSE_NOISE = "Noise of poses"
BOARD = "Board in three dimensions"
SCATTER = "Scatter of repeats"
PRIOR_STD = "Prior standard deviations"

#: Description of each method of cross-validation.
_HELD_OUT = {
    "leave-one-out": "each row predicted from the others alone",
    "leave-one-pose-out": "each pose, repeats and all, predicted from the others alone",
    "leave-one-station-out": "each station predicted from the others, except for its own frame",
    "leave-stations-out": "some stations predicted from the others, except for their own frames",
    "10-fold": "a tenth of the poses at a time, predicted from the others",
    "10-fold-in-time": "ten pieces of the path, a tenth of it, at a time, predicted from the others",
}


def calibration_line(c: Calibration) -> str:
    """Write a calibration in one line: robot, verdict, error before and after, rows."""
    verdict = "no verdict" if c.verdict is None else c.verdict.use
    where, before, after = before_and_after(c)
    errors = f"{where} rms {rms_text(before)} to {rms_text(after)}"
    return one_line(
        "Calibration", chain_name(c.nominal), verdict, errors, plural(len(c.rows), "row")
    )


def counted_rows(c: Calibration) -> str:
    """Count the rows of each set, or the images and their corners."""
    estimation, validation = (int(np.sum(s)) for s in (c.rows.estimation, c.rows.validation))
    images = c.rows.count_images(c.rows.estimation)
    if not images:
        return f"{estimation} rows for estimation and {validation} for validation"
    fresh = f"{c.rows.count_images(c.rows.validation)} with {validation}" if validation else "none"
    counted = f"{plural(images, 'image')} with {estimation} corners"
    return f"{counted} for estimation and {fresh} for validation"


def facts(c: Calibration) -> dict[str, str]:
    """Word the figures of a result besides its errors.

    Args:
        c: The result.

    Returns:
        A sentence for each label, as far as the figure exists: noise, scatter of repeats, expected error at a new
        point, prior standard deviations, rank.
    """
    result = {"Noise": noise_text(c)}
    if c.noise.pose_noise is not None:
        result[POSE_NOISE] = pose_noise_text(c.noise.pose_noise)

    if c.noise.repeats is not None:
        unit = next(iter(c.noise.repeats.within))
        scatter, freedom = c.noise.repeats.within[unit], c.noise.repeats.freedoms[unit]
        if np.isfinite(scatter):
            per = _per_scalar(c.rows.channels, unit)
            result[SCATTER] = f"{with_unit(scatter, unit)} {per} ({freedom:.0f} d.o.f.)."

    if c.unknown_accuracy:
        result[EXPECTED] = f"not known: {_UNKNOWN[c.unknown_accuracy]}."
    else:
        near, everywhere = c.new_point
        result[EXPECTED] = (
            f"{mm(near)} mm rms near the measured poses, {mm(everywhere)} mm over the joint limits."
        )
        scale = c.geometry.scale
        if scale is not None and c.geometry.by_scale[1] > _MOSTLY * everywhere:
            result[EXPECTED] += (
                f" Most of it is a scale error of the instrument of up to {100.0 * scale.bound:.2f} % in the "
                "arm's lengths: if the scale is known better, say so in the cell file (instrument)."
            )

    boards = ((c.geometry.board, "held-out"), (c.geometry.validation_board, "validation"))
    found = [_board_text(b, which) for b, which in boards if b is not None]
    if found:
        result[BOARD] = " ".join(found)

    if c.geometry.prior_std:
        sizes = []
        for family, std in c.geometry.prior_std.items():
            factor, symbol = FAMILIES[family].unit.shown
            size = f"{factor * std:.3g} {symbol}" if factor * std > _NOTHING else "none"
            sizes.append(f"{family} {size}")
        source = "estimated from the data" if c.method.prior_std_from == "data" else "as given"
        result[PRIOR_STD] = f"{', '.join(sizes)} ({source})."

    o = c.trust.observability
    result["Rank"] = f"{o.rank} of {o.columns} parameters, condition number {o.condition:.0f}."
    return result


def _board_text(b: BoardErrors, which: str) -> str:
    """Word the errors of the predicted poses of boards in three dimensions, by held-out or by validation views."""
    return (
        f"predicted to {mm(b.predicted_across)} mm across and {mm(b.predicted_depth)} mm along the line of sight: "
        f"rms of {b.views} {which} views, beyond their own noise ({mm(b.across_alone)} and {mm(b.depth_alone)} mm). "
        f"Mean along it {mm(b.depth_bias)} ± {mm(b.depth_bias_std)} mm."
    )


def noise_text(c: Calibration) -> str:
    """Word the estimated noise in each unit, and its source."""
    noise = [
        f"{with_unit(std, unit)} {_per_scalar(c.rows.channels, unit)}"
        for unit, std in c.noise.sigma.items()
    ]
    source = "mostly assumed: too few rows"
    if c.noise.freedom >= ENOUGH_FREEDOM:
        source = f"from residuals, {c.noise.freedom:.0f} d.o.f."
    return f"{listed(noise)} (1 sigma, {source})."


def pose_noise_text(noise: PoseNoise) -> str:
    """Word the scale of stated covariances, and what the robot adds to them."""
    along, about = with_unit(noise.position, "m"), with_unit(noise.orientation, "rad")
    added = f"{along} along and {about} about each axis of the measurement frame"
    if noise.joint > 0.0:
        added = f"{with_unit(noise.joint, 'rad')} at each joint, {added}"
    source = " (assumed: too few rows)" if noise == USUAL_POSE_NOISE else ""
    return (
        f"the stated standard deviations times {noise.scale:.2g}; the robot adds {added}{source}."
    )


def _per_scalar(channels: Channels, unit: str) -> str:
    """Word what the noise of one scalar is stated for, such as ``"per coordinate"``."""
    if unit == "m":
        return f"per {measured_lengths(channels)}"
    return RESIDUAL_UNITS[unit].per


def held_out_text(c: Calibration) -> str:
    """Word the footnote on ``held-out rows*``: the method; empty without cross-validation."""
    if c.cross_validation is None:
        return ""
    method = c.cross_validation.method
    return f"* {method}: {_HELD_OUT[method]}"


def weights_text(c: Calibration) -> str:
    """Word the weight of the outliers in the fit."""
    weights = dict(zip(c.rows.numbers, c.rows.weights, strict=True))
    unused = not any(weights.get(outlier.row) for outlier in c.rows.outliers)
    return "no weight in the fit" if unused else "full weight in the fit"


def outliers_text(c: Calibration, outliers: Sequence[Outlier]) -> str:
    """List rows, or the images that they are corners of, with residual and score; beyond `_LISTED` they are counted.

    If there are several targets, such as two hands, each row has the name of its own.
    """
    if not c.rows.images:
        target_of = dict(zip(c.rows.numbers, c.rows.targets, strict=True))
        rows = []
        for outlier in outliers[:_LISTED]:
            facts = [_rough_size(size, unit) for unit, size in outlier.residual.items()]
            if len(c.setup.targets) > 1:
                facts.insert(0, f"'{target_of[outlier.row]}'")
            rows.append(f"row {outlier.row} ({', '.join(facts)}, {outlier.score:.1f} sigma)")
        more = len(outliers) - _LISTED
        return "; ".join([*rows, f"and {more} more"] if more > 0 else rows)

    image_of = dict(zip(c.rows.numbers, c.rows.images, strict=True))
    by_image: dict[str, list[Outlier]] = {}
    for outlier in outliers:
        by_image.setdefault(image_of[outlier.row] or f"row {outlier.row}", []).append(outlier)
    images = []
    for image, of_image in list(by_image.items())[:_LISTED]:
        unit = next(iter(of_image[0].residual))
        largest = max(outlier.residual.get(unit, 0.0) for outlier in of_image)
        score = max(outlier.score for outlier in of_image)
        corners = plural(len(of_image), "corner")
        size = _rough_size(largest, unit)
        images.append(f"{image}, {corners} (up to {size}, {score:.1f} sigma)")
    more = len(by_image) - _LISTED
    return "; ".join([*images, f"and {plural(more, 'more image')}"] if more > 0 else images)


def _rough_size(value: float, unit: str) -> str:
    """Write an error with two digits and its unit."""
    return f"{shown(value, unit, 2)} {RESIDUAL_UNITS[unit].shown}"


def robustness_text(robustness: Robustness) -> str:
    """Word the effect of lowering the weights of doubtful rows.

    Args:
        robustness: Predictions and held-out errors with full and with lowered weights.

    Returns:
        The effect of the weights that the fit does not use.
    """
    used, other = robustness.errors_full, robustness.errors_lowered
    other_weights = "lowered"
    if robustness.lowered:
        used, other = other, used
        other_weights = "full"
    text = (
        f"With {other_weights} weight these rows would change the prediction by {mm(robustness.moved_rms)} mm rms "
        f"at the measured poses, {mm(robustness.moved_max)} mm at most"
    )
    figures = used.leading
    if figures.n:
        unit = RESIDUAL_UNITS[figures.unit]
        after = shown(other[figures.unit].rms, figures.unit)
        change = f"from about {shown(figures.rms, figures.unit)} to {after} {unit.shown} rms"
        text += f", and the held-out error of the others {change}"
    return text + "."


def errorless(c: Calibration) -> frozenset[str]:
    """Return the names of the parameters of families that the data showed to have no errors; none with given priors.

    Their family's estimated prior standard deviation is zero to the digits shown: they stay nominal, and their
    interval, which is zero too, is not shown, because it would be taken for knowledge of them.
    """
    if c.method.prior_std_from != "data":
        return frozenset()
    names = []
    for parameter, estimate in zip(c.model.parameters, c.parameters, strict=True):
        if parameter.family not in c.geometry.prior_std:
            continue
        limit = _NOTHING / FAMILIES[parameter.family].unit.shown[0]
        # A parameter with a prior of its own does not share the family's.
        if c.geometry.prior_std[parameter.family] <= limit and estimate.prior_std <= limit:
            names.append(parameter.name)
    return frozenset(names)


def unidentifiable_text(c: Calibration) -> str:
    """Word the heading of the unidentifiable combinations."""
    resolved = " (resolved by the priors only)" if c.geometry.prior_std else ""
    return f"Unidentifiable combinations{resolved}"


def shown_parameters(c: Calibration) -> list[ParameterEstimate]:
    """Return the parameters of the geometry that are listed.

    Frames and the orientations of targets are shown as poses instead, cameras and boards in sentences.
    """
    shown = []
    for estimate, parameter in zip(c.parameters, c.model.parameters, strict=True):
        of_frame = parameter.family == FRAME
        turns_target = parameter.family == TARGET and parameter.unit == "rad"
        if not of_frame and not turns_target and parameter.internal is None:
            shown.append(estimate)
    return shown


def solver_text(c: Calibration) -> str:
    """Word the end of the solver's iterations, without the time that they took."""
    s = c.method.solution
    return f"Solver '{c.method.solver}': {s.status} after {s.iterations} iterations, {s.evaluations} evaluations"
