"""Rows of a virtual cell: the target, the station and the pose of each, and what an instrument reads there.

    measured = T_frame_target(q) + drift + robot's repeatability + instrument's noise + outliers

What the robot does, with drift and repeatability, is the same for all instruments; a `Reader` adds the rest. For a
camera the target is the board, and each corner that it sees in a picture is a row:

    pixel = lens(T_camera_board(q) corner) + noise

OpenCV projects the corners, without any code of the fit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS, VECTOR
from calib.basics.values import Value, one_line
from calib.boards.board import Board
from calib.boards.detection.board_search import FEWEST_CORNERS
from calib.boards.project import Sight, corner_pixels
from calib.data.columns import DEFAULT_TARGET, SETS
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.data.surroundings import TrackerNoise
from calib.errors import CalibError
from calib.instruments.camera import LARGEST_TILT, board_tilts
from calib.verbs.simulate.disturbances import Outliers
from calib.verbs.simulate.equipment import Equipment
from calib.verbs.simulate.random_streams import stream
from calib.verbs.simulate.truth import Truth
from calib.verbs.simulate.views import filled_shares

#: Displacement of an outlier, a corner that was mistaken for another edge nearby [px].
OUTLIER = 5.0

#: Corners that are found: not at the very edge of the picture, nor on a board that is seen from its side.
SIGHT = Sight(margin=5.0, tilt=float(np.deg2rad(70.0)))

#: Least and largest share of the image's width or height that a board of several spans, else it is not used. The board
#: before which a camera is placed has 0.2 to 0.8; one beyond 1 is cut by the image, and too near to be sharp.
FILLED = (0.1, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """The R views of targets: all targets at each stop, one tour of the poses after the other."""

    #: (stops,), the pose of each stop.
    route: Integers
    #: (R,), the stop of each view.
    stop: Integers
    #: (R,), its target.
    target: Integers
    #: (R,), its station.
    group: Integers
    #: (R,), the number of the chain between them.
    chain: Integers
    #: (R,), its set.
    sets: tuple[str, ...]
    #: (R,), the other view of its pair; None: views are not paired.
    partner: Integers | None

    @classmethod
    def of(
        cls,
        truth: Truth,
        sets: Sequence[str],
        *,
        visits: int = 1,
        paired: bool = False,
        at_once: bool = False,
    ) -> Tour:
        """Return the views of a tour, one for each target at each stop.

        Stations on one link are one instrument, which takes the poses at them in turn; those on different links are
        several, all of which measure at each stop.

        Args:
            truth: Has the targets and the stations.
            sets: ``"estimate"`` or ``"validate"`` for each pose.
            visits: Number of times that all poses are visited.
            paired: Whether a target is measured at pairs of poses, which follow each other in their set.
            at_once: Whether all stations measure at each stop, as cameras do.

        Raises:
            CalibError: Pairs of an odd number of poses, or of poses at which different targets are measured.
        """
        sights = [(f, t, chain) for (f, t), chain in truth.sights.items()]
        links = truth.frame_links or ("",) * len(truth.groups)
        on_link: dict[str, list[int]] = {}
        for f in dict.fromkeys(f for f, _, _ in sights):
            on_link.setdefault(links[f], []).append(f)
        views: list[list[tuple[int, int, int]]] = []  # at each pose
        for pose in range(len(sets)):
            active = {members[pose % len(members)] for members in on_link.values()}
            views.append([sight for sight in sights if at_once or sight[0] in active])

        route = np.tile(np.arange(len(sets)), visits)
        counts = np.array([len(of_pose) for of_pose in views], dtype=np.int_)[route]
        stop = np.repeat(np.arange(len(route)), counts)
        each = [sight for pose in route.tolist() for sight in views[pose]]
        group, target, chain = np.array(each, dtype=np.int_).reshape(-1, 3).T
        partner = None
        if paired:
            # Consecutive poses of one set, the same target, the same visit.
            other = np.arange(len(sets))
            for name in SETS:
                members = [i for i, set_name in enumerate(sets) if set_name == name]
                if len(members) % 2:
                    raise CalibError(
                        f"Pairs need an even number of poses; {len(members)} are to '{name}'."
                    )
                other[members[::2]] = members[1::2]
                other[members[1::2]] = members[::2]
            if any(len(views[i]) != len(views[k]) for i, k in enumerate(other.tolist())):
                raise CalibError(
                    "Pairs are simulated of stations that see equally many targets; simulate the stations one by one."
                )
            first = np.cumsum(counts) - counts  # view of each stop
            stops_away = (other - np.arange(len(sets)))[route[stop]]
            partner = first[stop + stops_away] + np.arange(len(stop)) - first[stop]
        return cls(
            route=route,
            stop=stop,
            target=target,
            group=group,
            chain=chain,
            sets=tuple(sets[i] for i in route[stop]),
            partner=partner,
        )

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.stop)

    @property
    def pairs(self) -> tuple[str, ...]:
        """Name of each view's pair, such as ``"pair 1"`` for both of its views; empty if it has none."""
        names = [""] * len(self)
        if self.partner is not None:
            first = np.flatnonzero(np.arange(len(self)) < self.partner)
            for k, i in enumerate(first, start=1):
                names[i] = names[self.partner[i]] = f"pair {k}"
        return tuple(names)

    def with_partners(self, T: Array) -> Array:
        """Return the poses of all views (R, 4, 4) as they are, or of pairs each with its partner's, (R, 2, 4, 4)."""
        if self.partner is None:
            return T
        return np.stack([T, T[self.partner]], axis=1)


class Stops(NamedTuple):
    """Joint values of the robot at the stops of a tour of R views, and the poses of the targets there."""

    tour: Tour
    #: Shape (stops, m), joint values that are read, [rad] or [m].
    read_q: Array
    #: Shape (stops, m), true joint values, [rad] or [m].
    true_q: Array
    #: Shape (R, 4, 4), true poses of the targets in their frames [m].
    T_frame_target: Array
    #: Shape (R, 4, 4), the same with drift and the robot's repeatability [m].
    displaced: Array


@dataclass(frozen=True, slots=True, eq=False)
class Pictures(Value):
    """P pictures of a board, and the R corners that are seen in them; of two boards in one image there are two."""

    #: The cameras and the boards as they are.
    equipment: Equipment
    #: Names of the pictures' files.
    images: tuple[str, ...]
    #: ``"estimate"`` or ``"validate"`` for each picture.
    sets: tuple[str, ...]
    #: Number of each picture's camera, shape (P,), from 0.
    camera: Integers
    #: Number of its board, shape (P,), from 0.
    board: Integers
    #: Readings of the joints, shape (P, m), [rad] or [m].
    readings: Array
    #: True joint values, shape (P, m), [rad] or [m].
    q: Array
    #: True pose of the board in the camera, with the robot's repeatability, shape (P, 4, 4) [m].
    T_camera_board: Array
    #: The picture of each corner, shape (R,), from 0.
    picture: Integers
    #: Its id on the board, shape (R,).
    corner: Integers
    #: Its true place in the picture, shape (R, 2) [px].
    true_pixels: Array
    #: The place where it is found, shape (R, 2) [px].
    pixels: Array
    #: Standard deviation of the noise of a coordinate [px].
    sigma: float
    #: Last move of each joint before each picture, shape (P, m), [rad] or [m]; None: from the picture before.
    moves: Array | None = None

    def __repr__(self) -> str:
        """Return one line: pictures and corners."""
        count = len(set(self.images))
        return one_line("Pictures", f"{count} pictures", f"{len(self.picture)} corners")


class Rows(NamedTuple):
    """Rows that an instrument reads."""

    #: Shape (n,), the view that each row is of, from 0.
    view: Integers
    #: Columns of the table besides joints and sets, as `Measurements` has them.
    columns: Mapping[str, Any]
    #: Shape (n,), standard deviation of the noise of one scalar, with the robot's repeatability, [m] or [px].
    sigma: Array
    #: Shape (n, 3) [m] or (n, 2) [px], displacement of outliers; zero in other rows.
    outliers: Array
    #: The pictures that a camera took; None: another instrument.
    pictures: Pictures | None = None


class Reader(ABC):
    """An instrument that reads targets with its noise."""

    @abstractmethod
    def read(self, stops: Stops, seed: int) -> Rows:
        """Read all targets of a tour, with the instrument's noise and outliers.

        Args:
            stops: The stops of the robot, and the poses of the targets there.
            seed: Of the random numbers.

        Raises:
            CalibError: There are fewer rows than outliers, or a camera sees nothing.
        """


@dataclass(frozen=True, slots=True, eq=False)
class TrackerReader(Reader):
    """A tracker, or another instrument that measures targets as a kind of measurement says."""

    kind: Kind
    #: The targets and the frames.
    truth: Truth
    #: Noise of a coordinate or length; None: none.
    noise: TrackerNoise | None
    #: Standard deviation of one scalar in the other units, by their symbols; 0 if it is missing.
    sigma: Mapping[str, float]
    #: Shape (3,), position of the tracker in the base [m]; None: at the origin of its frame.
    position: Array | None
    #: None: none.
    outliers: Outliers | None

    def read(self, stops: Stops, seed: int) -> Rows:
        """Read one row at each view: what the kind measures of the displaced target, with noise and outliers."""
        kind, truth, tour, T = self.kind, self.truth, stops.tour, stops.T_frame_target
        assert kind.measure is not None
        instrument = self._instrument_std(tour, T)
        outliers = self._draw_outliers(tour, seed)
        # By quantity, shape (R, 3 or more) each, in its residual unit: three columns for a vector, then one for each
        # single reading. Lengths have the standard deviation of each row.
        noise: dict[str, Array] = {}
        for symbol, unit in RESIDUAL_UNITS.items():
            quantity = unit.quantity
            further = sum(reading.quantity == quantity for reading in kind.readings)
            random = stream(seed, "tracker noise" if symbol == "m" else f"{quantity} noise")
            of_vector = random.standard_normal((len(instrument), VECTOR))
            of_readings = random.standard_normal((len(instrument), further))
            unit_normal = np.hstack([of_vector, of_readings])
            std = np.full(len(instrument), self.sigma.get(symbol, 0.0))
            noise[quantity] = unit_normal * (instrument if symbol == "m" else std)[:, None]
        noise["length"][:, :VECTOR] += outliers
        exact = kind.measure(tour.with_partners(stops.displaced))
        noisy = with_pose_noise(kind, exact, T[:, :3, :3], noise)
        if tour.partner is not None:  # both rows of a pair hold the one reading
            first_rows = np.minimum(np.arange(len(T)), tour.partner)
            noise = {quantity: added[first_rows] for quantity, added in noise.items()}
        repeatability = self.noise.repeatability if self.noise else 0.0
        rows_per_reading = 2.0 if kind.paired else 1.0
        return Rows(
            view=np.arange(len(tour)),
            columns={
                "targets": tuple(truth.targets[t] for t in tour.target),
                "groups": tuple(truth.groups[g] for g in tour.group),
                "kinds": (kind.name,) * len(tour),
                "pairs": tour.pairs,
                **Measurements.columns_of(kind, with_reading_noise(kind, noisy, noise)),
            },
            sigma=np.hypot(instrument, np.sqrt(rows_per_reading) * repeatability),
            outliers=outliers,
        )

    def _instrument_std(self, tour: Tour, T: Array) -> Array:
        """Return the standard deviation of lengths by the instrument alone at R views, (R,) [m].

        It depends on the distances of the targets, whose true poses in their frames are T, (R, 4, 4) [m].
        """
        noise, kind = self.noise, self.kind
        if noise is None:
            return np.zeros(len(T))
        distance = np.linalg.norm(T[:, :3, 3], axis=1)
        lengths = [i for i, one in enumerate(kind.readings) if one.quantity == "length"]
        if lengths and not kind.position:  # the length is measured from the instrument
            assert kind.measure is not None
            distance = np.abs(kind.measure(tour.with_partners(T))[:, lengths[0]])
        elif self.position is not None:
            T_frame_base = self.truth.T_frame_base[tour.group]
            position = T_frame_base[:, :3, :3] @ self.position + T_frame_base[:, :3, 3]
            distance = np.linalg.norm(T[:, :3, 3] - position, axis=1)
        return np.asarray(noise.constant + noise.per_length * distance)

    def _draw_outliers(self, tour: Tour, seed: int) -> Array:
        """Draw the displacement of each row's measurement, (R, 3) [m]; it is zero except in outliers.

        Outliers are among the rows to estimate from, of a pair its first row. Without a measured position the first
        column is the change of the length, and the others are zero.
        """
        displacement = np.zeros((len(tour), 3))
        if self.outliers is None:
            return displacement
        rows = np.arange(len(tour))
        first = rows if tour.partner is None else rows[rows < tour.partner]
        candidates = [i for i in first.tolist() if tour.sets[i] == SETS[0]]
        chosen = self.outliers.choose(candidates, seed)
        directions = stream(seed, "outlier directions").standard_normal(displacement.shape)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        if not self.kind.position:
            directions = np.sign(directions) * (1.0, 0.0, 0.0)
        displacement[chosen] = self.outliers.size * directions[chosen]
        return displacement


@dataclass(frozen=True, slots=True, eq=False)
class CameraReader(Reader):
    """Cameras that each take a picture at every stop."""

    kind: Kind
    #: The cameras and the boards as they are.
    equipment: Equipment
    #: Names of the stations, one for each camera.
    groups: tuple[str, ...]
    #: Names of the targets, one for each board.
    targets: tuple[str, ...]
    #: Standard deviation of the noise of a coordinate [px].
    sigma: float
    #: None: none.
    outliers: Outliers | None

    def read(self, stops: Stops, seed: int) -> Rows:
        """Find the corners that are seen in each picture, a row each; raises `CalibError` if none is seen in any."""
        tour, equipment = stops.tour, self.equipment
        T, sets = stops.displaced, tour.sets
        random = stream(seed, "pixel noise")
        numbers: list[Integers] = []  # of picture and corner, (2, n) each
        places: list[Array] = []  # true and found in the picture, and on the board, (n, 7) each
        sights = dict.fromkeys(zip(tour.group.tolist(), tour.target.tolist(), strict=True))
        for f, t in sights:
            views = np.flatnonzero((tour.group == f) & (tour.target == t))
            printed = equipment.prints[t]
            pixels, is_seen = corner_pixels(equipment.cameras[f], printed.corners, T[views], SIGHT)
            if len(sights) > 1:  # a board that comes into view by chance
                is_used = _is_detected(printed.board, is_seen)
                is_used &= board_tilts(printed.board, T[views]) <= LARGEST_TILT
                fills = filled_shares(equipment.cameras[f], pixels)  # NaN: partly behind it
                is_used &= (fills >= FILLED[0]) & (fills <= FILLED[1])
                is_seen &= is_used[:, None]
            view, corner = np.nonzero(is_seen)
            # Drawn for all corners, seen or not, so that the noise of one does not depend on which others are seen.
            found = pixels + self.sigma * random.standard_normal(pixels.shape)
            points = printed.board.corners[corner]
            numbers.append(np.stack([views[view], corner]))
            places.append(np.hstack([pixels[is_seen], found[is_seen], points]))
        picture, corner = np.concatenate(numbers, axis=1)
        order = np.argsort(picture, kind="stable")
        picture, corner = picture[order], corner[order]
        true_pixels, found, points = np.split(np.concatenate(places)[order], [2, 4], axis=1)
        if not len(picture):
            seen_by = "The camera sees no corner of the board"
            if len(sights) > 1:
                seen_by = "No camera sees a corner of a board"
            raise CalibError(
                f"{seen_by} from any of the {len(tour.route)} poses; without --poses, poses are drawn from which it "
                "does."
            )
        outliers = np.zeros((len(picture), 2))
        if self.outliers is not None:
            candidates = [row for row, k in enumerate(picture.tolist()) if sets[k] == SETS[0]]
            chosen = self.outliers.choose(candidates, seed)
            angle = stream(seed, "outlier directions").uniform(0.0, 2.0 * np.pi, len(picture))
            directions = np.column_stack([np.cos(angle), np.sin(angle)])
            outliers[chosen] = OUTLIER * directions[chosen]
        found = found + outliers

        digits = max(2, len(str(len(tour.route))))
        images = tuple(
            f"{self.groups[f] or 'picture'}_{stop + 1:0{digits}}.png"
            for f, stop in zip(tour.group.tolist(), tour.stop.tolist(), strict=True)
        )
        sigma = np.full(len(picture), self.sigma)
        words: dict[str, tuple[str, ...]] = {}
        if self.groups != ("",):
            words["groups"] = tuple(self.groups[f] for f in tour.group[picture])
        if self.targets != (DEFAULT_TARGET,):
            words["targets"] = tuple(self.targets[t] for t in tour.target[picture])
        return Rows(
            view=picture,
            columns={
                "kinds": (self.kind.name,) * len(picture),
                "images": tuple(images[k] for k in picture.tolist()),
                "corners": tuple(map(str, corner.tolist())),
                "board_points": points,
                "sigma": {"px": sigma} if self.sigma > 0.0 else {},
                **words,
                **Measurements.columns_of(self.kind, found),
            },
            sigma=sigma,
            outliers=outliers,
            pictures=Pictures(
                equipment=equipment,
                images=images,
                sets=sets,
                camera=tour.group,
                board=tour.target,
                readings=read_only(stops.read_q[tour.stop]),
                q=read_only(stops.true_q[tour.stop]),
                T_camera_board=read_only(T),
                picture=picture,
                corner=corner,
                true_pixels=read_only(true_pixels),
                pixels=read_only(found),
                sigma=self.sigma,
            ),
        )


def _is_detected(board: Board, is_seen: Mask) -> Mask:
    """Return whether `calib detect` finds a board by the corners that N pictures show, (N, n), shape (N,)."""
    corners = is_seen.shape[1]
    fewest = min(FEWEST_CORNERS, corners) if board.markers else corners
    return np.asarray(is_seen.sum(axis=1) >= fewest)


def with_pose_noise(kind: Kind, readings: Array, R: Array, noise: Mapping[str, Array]) -> Array:
    """Add noise to the position and the orientation that a kind measures, if it measures them.

    Args:
        kind: The kind of all N rows.
        readings: Of a perfect instrument, shape (N, k), as `Kind` has them.
        R: True orientations of the targets in the frames, shape (N, 3, 3).
        noise: Of ``"length"`` [m] and ``"angle"`` [rad], shape (N, 3) or more, of which the first three columns are
            taken; angles are a rotation vector along the axes of the frame.

    Returns:
        The readings with noise, shape (N, k).
    """
    result = readings.copy()
    if kind.position:
        result[:, :VECTOR] += noise["length"][:, :VECTOR]
    if kind.orientation:
        turns = Rotation.from_rotvec(noise["angle"][:, :VECTOR])
        R_noisy = turns.as_matrix() @ R
        result[:, VECTOR : VECTOR + 9] = R_noisy.reshape(-1, 9)
    return np.asarray(result)


def with_reading_noise(kind: Kind, readings: Array, noise: Mapping[str, Array]) -> Array:
    """Add noise to the single readings of a kind, such as a distance.

    Args:
        kind: The kind of all N rows.
        readings: shape (N, k), as `Kind` has them.
        noise: By quantity, in the readings' units, shape (N, n): a column for each of its readings in their order,
            after three columns if the kind measures a position (for lengths) or an orientation (for angles).

    Returns:
        The readings with noise, shape (N, k). If noise would make a positive reading negative, its absolute value is
        taken.
    """
    result = readings.copy()
    first = kind.size - len(kind.readings)
    next_column = {"length": VECTOR * kind.position, "angle": VECTOR * kind.orientation}
    for k, reading in enumerate(kind.readings, start=first):
        column = next_column.get(reading.quantity, 0)
        next_column[reading.quantity] = column + 1
        result[:, k] += noise[reading.quantity][:, column]
        if reading.positive:
            result[:, k] = np.abs(result[:, k])
    return np.asarray(result)
