"""A simulation as text, as `calib simulate` prints it: a row for each thing that was simulated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.boards.project import corner_pixels
from calib.camera.lenses import LENSES
from calib.data.columns import SETS
from calib.instruments.camera import board_tilts
from calib.model.error_model import MOUNT
from calib.model.families import FAMILIES, unit_of
from calib.numerics.errors import rms
from calib.show.lines import fill, plural, row_ranges
from calib.show.tables import labelled
from calib.verbs.simulate.scenario import Scenario, Simulated
from calib.verbs.simulate.simulated_rows import OUTLIER, Pictures
from calib.verbs.simulate.truth import Truth
from calib.verbs.simulate.views import filled_shares

#: Width of a label [columns].
_LABEL = 26

#: A frame whose pose differs from the identity by less is the base frame.
_ROUNDING = 1e-12


def simulated_text(scenario: Scenario, simulated: Simulated) -> str:
    """Write what was simulated, in lines of 100 columns.

    That is the errors of the robot, the places of targets and frames, or the camera, the print and their mounts, and
    what disturbed the measurements.
    """
    robot, pictures = scenario.robot, simulated.pictures
    if pictures is None:
        sets = simulated.measurements.sets
        counts = f"{len(sets)} rows{_count_sets(sets)}"
        chains = " and ".join(f"{chain.base} to {chain.tip}" for chain in robot.chains)
        title = f"Simulated: robot '{robot.name}', {chains}, {counts}."
        facts = _tracker_facts(scenario, simulated)
    else:
        truth = simulated.truth
        sets = tuple(_sets_of_images(pictures))
        counts = f"{plural(len(pictures.picture), 'corner')} in {plural(len(sets), 'picture')}{_count_sets(sets)}"
        cameras = " and ".join(dict.fromkeys(truth.frame_links))
        boards = " and ".join(dict.fromkeys(truth.target_links))
        title = (
            f"Simulated: robot '{robot.name}', camera on {cameras}, board on {boards}, {counts}."
        )
        facts = _picture_facts(scenario, simulated, pictures)
    lines = [fill(title), ""]
    for label, text in facts:
        if text:
            lines.append(labelled(label, text, _LABEL))
    return "\n".join(lines)


def _sets_of_images(pictures: Pictures) -> list[str]:
    """Return the set of each image, in which several boards may be seen; of several cameras those that show one."""
    shown = range(len(pictures.images))
    if len(set(pictures.camera.tolist())) > 1:
        shown = np.unique(pictures.picture).tolist()
    return list({pictures.images[k]: pictures.sets[k] for k in shown}.values())


def _count_sets(sets: Sequence[str]) -> str:
    """Word in brackets how many rows or pictures are of each set; empty if all are to estimate from."""
    estimation = sum(name == SETS[0] for name in sets)
    if estimation == len(sets):
        return ""
    return f" ({estimation} for estimation, {len(sets) - estimation} for validation)"


def error_lines(truth: Truth, q: Array) -> Iterator[tuple[str, str]]:
    """Yield label and text of the error model, of the true errors of each family, and of the nominal robot's errors.

    Args:
        truth: The robot with its errors, and its targets, whose first one shows the nominal robot's position errors.
        q: True joint values of the measurements, shape (N, m), [rad] or [m].

    Of several chains the nominal robot's errors are those of each.
    """
    families = _errors_by_family(truth)
    model = f"model {truth.model.name}"
    if not families:
        model += "; all errors are zero"
    yield "True errors", model
    for (family, unit), errors in families.items():
        factor, symbol = unit_of(unit).shown
        name = max(errors, key=lambda name: abs(errors[name]))
        size = factor * rms(np.array(list(errors.values())))
        largest = f"{name} {factor * errors[name]:.3g} {symbol}"
        label = "place of a robot" if family == MOUNT else family
        yield f"  {label}", f"{len(errors)}, rms {size:.3g} {symbol}, largest {largest}"
    for (f, t), chain in truth.sights.items():
        if list(truth.sights.values()).index(chain) != list(truth.sights).index((f, t)):
            continue  # another target on the same link
        distances = truth.nominal_errors(q, t, f)
        text = f"{_mm(rms(distances))} mm rms, {_mm(distances.max())} mm at most"
        who = "of the nominal robot"
        if len(truth.nominal.chains) > 1:
            who = "nominal robot off by"
            ends = truth.nominal.chains[chain]
            text = f"{ends.base} to {ends.tip}: {text}"
        yield f"  {who}", text


def _errors_by_family(truth: Truth) -> dict[tuple[str, str], dict[str, float]]:
    """Return the true errors that are not 0 by their names, in their SI units, for each family and unit in it.

    Families are in the order of `FAMILIES`, places of further robots last.
    """
    families: dict[tuple[str, str], dict[str, float]] = {}
    for parameter, value in zip(truth.model.parameters, truth.x, strict=True):
        if value:
            errors = families.setdefault((parameter.family, parameter.unit), {})
            errors[parameter.name] = float(value)
    order = [*FAMILIES, MOUNT]
    keys = sorted(families, key=lambda key: (order.index(key[0]), key[1]))
    return {key: families[key] for key in keys}


def _tracker_facts(scenario: Scenario, simulated: Simulated) -> Iterator[tuple[str, str]]:
    """Yield label and text of each fact about rows of a tracker, without disturbances that are absent.

    The text of encoder steps is empty if there are none.
    """
    truth, kind = simulated.truth, scenario.kind
    yield "Each row measures", f"the {kind.words}"
    yield "Targets at each pose", ", ".join(truth.targets)
    in_turn = len(set(truth.frame_links)) <= 1
    yield "Stations in turn" if in_turn else "Stations", ", ".join(truth.groups)
    yield "Visits of each pose", str(scenario.visits)
    yield from error_lines(truth, simulated.q)

    # True places of targets and frames.
    several = len(truth.nominal.chains) > 1
    targets = zip(truth.targets, truth.T_tip_target, truth.stated_T_tip_target, strict=True)
    for t, (name, T, given) in enumerate(targets):
        link = truth.target_links[t] if several else "the tip"
        place = f"{point_mm(T[:3, 3])} mm in {link}, given as {point_mm(given[:3, 3])} mm"
        yield f"Target '{name}'", place
    if kind.directions:  # else no row depends on a frame
        for f, (name, T) in enumerate(zip(truth.groups, truth.T_frame_base, strict=True)):
            link = truth.frame_links[f] if several else "the base"
            place = f"{link} is at {point_mm(T[:3, 3])} mm in it"
            if np.abs(T - np.eye(4)).max() < _ROUNDING:
                place = "the base frame"
            yield f"Frame of '{name}'" if name else "Measurement frame", place

    if "m" in kind.units:
        noisy = "coordinate" if "m" in kind.vector_units else "length"
        yield f"Noise of a {noisy}", _noise(scenario, simulated)
    if "rad" in kind.units:
        angle = np.degrees(scenario.sigma.get("rad", 0.0))
        yield "Noise of an orientation", f"{angle:g} deg about each axis"
    if "px" in kind.units:
        yield "Noise of an image coordinate", f"{scenario.sigma.get('px', 0.0):g} px"

    yield "Encoder steps", encoder_steps(scenario)
    if simulated.outlier_rows and scenario.outliers is not None:
        size = _mm(scenario.outliers.size)
        yield f"Outliers of {size} mm", f"rows {row_ranges(simulated.outlier_rows)}"
    moved = scenario.moved
    if moved is not None:
        who = "all targets" if moved.target is None else f"'{moved.target}'"
        by = f"{point_mm(moved.by)} mm in the tip before row {moved.row}"
        yield "Moved target", f"{who} by {by}: {int(simulated.moved.sum())} rows"
    if scenario.drift.any():
        yield "Drift, first to last row", f"{point_mm(scenario.drift)} mm in the measurement frame"
    if scenario.step is not None:
        by = f"{point_mm(scenario.step.by)} mm in the measurement frame"
        yield "Step of the frame", f"{by} before row {scenario.step.row}"
    references = simulated.measurements.references
    if references is not None:
        stops = f"every {plural(scenario.standing.every, 'stop')}"
        count = plural(len(simulated.standing), "target")
        yield "Targets that stand still", f"{count}, read {stops}: {len(references)} readings"


def _picture_facts(
    scenario: Scenario, simulated: Simulated, pictures: Pictures
) -> Iterator[tuple[str, str]]:
    """Yield label and text of each fact about pictures and true errors; the text of encoder steps may be empty."""
    truth, equipment = simulated.truth, pictures.equipment
    several = len(truth.sights) > 1
    for f, t in truth.sights:
        # The pictures with corners of a board.
        camera, printed = equipment.cameras[f], equipment.prints[t]
        here = np.flatnonzero((pictures.camera == f) & (pictures.board == t))
        corners = len(printed.corners)
        counts = np.bincount(pictures.picture, minlength=len(pictures.images))[here]
        fewest = counts.min()
        text = f"{fewest} to {corners} of {corners}"
        if several:
            in_view = counts > 0
            here, fewest = here[in_view], min(counts[in_view], default=0)
            text = f"{truth.targets[t]} seen by {truth.groups[f]}: {plural(len(here), 'picture')}"
            if len(here):
                text += f", {fewest} to {corners} of {corners}"
        yield "Corners in a picture", text
        T = pictures.T_camera_board[np.intersect1d(pictures.picture, here)]
        if len(T):
            tilts = np.rad2deg(board_tilts(printed.board, T))
            fills = 100.0 * filled_shares(camera, corner_pixels(camera, printed.corners, T)[0])
            yield (
                "Board in the pictures",
                f"tilted by {tilts.min():.0f} to {tilts.max():.0f} deg, spans {fills.min():.0f} to "
                f"{fills.max():.0f} % of the image",
            )
    alike = shown_twice(pictures)
    if alike:
        twice = [truth.targets[t] for t in alike]
        files = " ".join(f"--board {name}={name}.toml" for name in twice)
        yield (
            "Same board twice",
            f"{' and '.join(twice)} are in one picture with one description, as if one print were in several places; "
            f"'calib detect' cannot tell them apart. Describe boards with different markers: {files}",
        )
    yield from error_lines(truth, pictures.q)

    for f, (camera, stated) in enumerate(
        zip(equipment.cameras, equipment.stated_cameras, strict=True)
    ):
        names = LENSES[camera.lens].names
        words = []
        for values in (camera.values, stated.values):
            numbers = [] if values is None else zip(names, values.tolist(), strict=True)
            words.append(", ".join(f"{name} {value:.6g}" for name, value in numbers))
        label = f"Camera '{truth.groups[f]}'" if truth.groups[f] else "Camera"
        yield label, f"{camera.width} x {camera.height} px, {camera.lens}; true {words[0]}"
        yield "  stated", words[1] or "nothing but the size"
        T_base_camera = rigid_inverse(truth.T_frame_base[f])
        yield "  mounted", f"at {point_mm(T_base_camera[:3, 3])} mm in {truth.frame_links[f]}"

    for t, printed in enumerate(equipment.prints):
        board = printed.board
        pattern = f"{board.pattern} of {board.columns} x {board.rows}, {1e3 * board.square:g} mm"
        scale_x, scale_y = (100.0 * (scale - 1.0) for scale in printed.scale)
        sag_x, sag_y = (1e3 * sag for sag in printed.warp)
        text = (
            f"{pattern}; printed {scale_x:+.2f} % wide and {scale_y:+.2f} % high, sags by {sag_x:.2f} mm along x and "
            f"{sag_y:.2f} mm along y"
        )
        if printed.offsets is not None:
            text += f", corners {1e6 * rms(printed.offsets[:, :2].ravel()):.0f} um rms off"
        yield f"Board '{truth.targets[t]}'" if len(equipment.prints) > 1 else "Board", text
        middle = truth.T_tip_target[t] @ np.append(board.centre, 1.0)
        yield "  mounted", f"its middle at {point_mm(middle[:3])} mm in {truth.target_links[t]}"

    yield "Noise of a corner", f"{pictures.sigma:g} px along u and along v, in a table (-o)"
    if scenario.noise is not None and scenario.noise.repeatability:
        yield "Repeatability", f"{1e6 * scenario.noise.repeatability:g} um per coordinate"
    yield "Encoder steps", encoder_steps(scenario)
    if simulated.outlier_rows:
        yield f"Outliers of {OUTLIER:g} px", f"rows {row_ranges(simulated.outlier_rows)}"


def shown_twice(pictures: Pictures) -> tuple[int, ...]:
    """Return the numbers of the boards that are in one picture with another of the same print, in rising order."""
    prints = pictures.equipment.prints
    in_image: dict[str, list[int]] = {}
    for k in np.unique(pictures.picture).tolist():
        in_image.setdefault(pictures.images[k], []).append(int(pictures.board[k]))
    alike = {
        t
        for boards in in_image.values()
        for t in boards
        if sum(prints[other] is prints[t] for other in boards) > 1
    }
    return tuple(sorted(alike))


def encoder_steps(scenario: Scenario) -> str:
    """Word the steps of the encoders in deg and mm; those of 0 are left out, so that the text may be empty."""
    encoder = scenario.encoder
    steps = (f"{np.degrees(encoder.angle):g} deg", f"{1e3 * encoder.length:g} mm")
    nonzero_steps = [step for step in steps if not step.startswith("0 ")]
    return ", ".join(nonzero_steps)


def _noise(scenario: Scenario, simulated: Simulated) -> str:
    """Word the standard deviation of the noise of a length, its range over the rows [mm], and its parts."""
    noise = scenario.noise
    if noise is None:
        return "none"
    low, high = _mm(simulated.sigma.min()), _mm(simulated.sigma.max())
    std = low if low == high else f"{low} to {high}"
    text = f"{std} mm std: instrument {1e6 * noise.constant:g} um"
    if noise.per_length:
        text += f" + {1e6 * noise.per_length:g} um/m"
    if noise.repeatability:
        text += f", robot {1e6 * noise.repeatability:g} um"
    return text


def _mm(value: float) -> str:
    """Format a length [m] in mm with three significant digits."""
    return f"{1e3 * float(value):.3g}"


def point_mm(values: Array) -> str:
    """Format three lengths [m] in mm."""
    coordinates = [f"{1e3 * v + 0.0:.3f}".rstrip("0").rstrip(".") for v in values]
    return f"({', '.join(coordinates)})"
