"""Many rows, never all of their derivatives at once: what a fit asks of them, in passes of the compiled kernel.

Rows of one kind make a stream. A pass goes through the streams in chunks, each of which is put together from blocks in
the same order whatever the number of threads. Nothing is kept that grows with rows times parameters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calib.identify.roots import compressed, smallest_eigenvalue, triangle_of, upper_root
from calib.identify.rows import NONE, Rows
from calib.identify.streams import Stream, stream_of
from calib.model.batch import chunks, fixed, geometry_of, in_threads, stood_at
from calib.model.kinematics import Kinematics

if TYPE_CHECKING:
    from calib.model.kernel_types import Geometry, Measured, Stood

Array = NDArray[np.float64]

#: Normal matrices that are remembered: the solver asks for those of a point that a stage asks for again.
_REMEMBERED = 3

#: Below this an eigenvalue of a scaled normal matrix is half rounding.
_UNCLEAR = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """All rows of a problem, as streams.

    Attributes:
        kinematics: The robot under its error model.
        rows: The rows.
        streams: One for each kind.
    """

    kinematics: Kinematics
    rows: Rows
    streams: tuple[Stream, ...]
    _normals: list[tuple[Array, Array, Array]] = field(default_factory=list, repr=False)
    _chains: list[tuple[Array, Geometry]] = field(default_factory=list, repr=False)

    @classmethod
    def of(cls, kinematics: Kinematics, rows: Rows) -> Passes:
        """From a problem's rows."""
        found = sorted(int(k) for k in np.unique(rows.kinds) if k != NONE)
        # As `Rows.instruments` numbers them: the kinds' lengths, then the angles of poses.
        numbers = {kind: i for i, kind in enumerate(found)}
        return cls(kinematics, rows, tuple(stream_of(rows, kind, numbers) for kind in found))

    @property
    def instruments(self) -> int:
        """The number of instruments."""
        return 1 + max(max(s.lengths, s.angles) for s in self.streams)

    def forget(self) -> None:
        """Remember no normal matrix, so that the next one is computed whatever was asked before."""
        self._normals.clear()

    @property
    def typical(self) -> tuple[float, ...]:
        """Median standard deviation of each instrument as given or first assumed [m], [rad]."""
        result = [0.0] * self.instruments
        for stream in self.streams:
            result[stream.lengths], of_angles = stream.typical
            if stream.angles >= 0:
                result[stream.angles] = of_angles
        return tuple(result)

    def noise_of(self, scales: Array) -> tuple[float, ...]:
        """What each instrument's sigma is multiplied by in some standard deviations, shape (N, width), of all rows."""
        result = [1.0] * self.instruments
        for stream in self.streams:
            i = stream.first
            result[stream.lengths] = float(scales[i, 0] / self.rows.sigma[i])
            if stream.angles >= 0:
                result[stream.angles] = float(scales[i, 3] / self.rows.sigma_angle[i])
        return tuple(result)

    def system(
        self, x: Array, weights: Array, scales: Array, precision: Array
    ) -> tuple[Array, Array]:
        """Numbers, p + 1 of them, and their derivative that stand for all rows' whitened residual and its derivative.

        Their squares, products and sums of squares are those of the rows: [J r] = Q R, and R is what is given. It is
        made of the normal matrix, or by QR where parameters can hardly be told from each other.

        Args:
            x: shape (p,).
            weights: shape (N,), of the rows.
            scales: shape (N, width), standard deviation of each scalar, [m] and [rad].
            precision: shape (p,), 1 / tau^2 of the priors that hold the parameters besides.

        Returns:
            shape (p + 1,) and shape (p + 1, p).
        """
        p, noise = len(x), self.noise_of(scales)
        H = np.tensordot(1.0 / np.square(noise), self.normal(x, weights), 1)
        R = compressed(H)
        if smallest_eigenvalue(H[:p, :p] + np.diag(precision)) < _UNCLEAR:
            R = self.triangle(x, np.sqrt(weights), noise)
        return R[:, p], -R[:, :p]

    def normal(self, x: Array, weights: Array) -> Array:
        """[J r]^T W [J r] of each instrument, in units of the sigma given, shape (C, p + 1, p + 1).

        Args:
            x: shape (p,).
            weights: shape (N,), of the rows.
        """
        for at, of, found in self._normals:
            if np.array_equal(at, x) and np.array_equal(of, weights):
                return found
        result = np.zeros((self.instruments, len(x) + 1, len(x) + 1))
        root = np.sqrt(weights)
        for stream in self.streams:
            result[stream.lengths], of_angles = self._normal_of(stream, x, root)
            if stream.angles >= 0:
                result[stream.angles] = of_angles
        result.setflags(write=False)
        self._normals.insert(0, (x.copy(), weights.copy(), result))
        del self._normals[_REMEMBERED:]
        return result

    def norms(
        self,
        x: Array,
        moved: Array,
        covariance: Array,
        weights: Array,
        noise: tuple[float, ...],
        instrument: int | None = None,
    ) -> Array:
        """How far each row lies from what the others predict, in standard deviations, shape (N,).

        Args:
            x: shape (p,), where the problem is linearised.
            moved: shape (p,), from there to where it is looked at.
            covariance: shape (p, p), of the parameters.
            weights: shape (N,), of the rows.
            noise: Of each instrument, over the sigma given.
            instrument: The one whose scalars count; None for all of them.
        """
        root = np.zeros((_tiles(len(x)), _tiles(len(x))))
        root[: len(x), : len(x)] = upper_root(covariance)
        result = np.zeros(len(self.rows))
        for stream in self.streams:
            part = 0
            if instrument is not None:
                if instrument not in (stream.lengths, stream.angles):
                    continue
                part = 1 if instrument == stream.lengths else 2
            stream.put(self._norms_of(stream, x, moved, root, weights, noise, part), result)
        return result

    def residual(self, x: Array) -> Array:
        """Measured minus predicted, shape (N, width), [m] and [rad]."""
        result = np.zeros((len(self.rows), self.rows.width))
        for stream in self.streams:
            out = np.empty((len(stream), stream.width, 1))
            self._rows_of(stream, x, None, out)
            if stream.index is None:
                result[:, : stream.width] = out[:, :, 0]
            else:
                result[stream.index, : stream.width] = out[:, :, 0]
        return result

    def derivatives(self, x: Array, root: Array) -> Iterator[tuple[NDArray[np.int_], Array]]:
        """[J r] in units of the sigma given, chunk by chunk.

        Args:
            x: shape (p,).
            root: shape (N,), what each row is multiplied by.

        Yields:
            Numbers of M rows, and shape (M, width, p + 1); scalars that a row lacks are zero.
        """
        for stream in self.streams:
            for first, last in chunks(len(stream)):
                out = np.zeros((last - first, self.rows.width, len(x) + 1))
                self._rows_of(stream, x, root, out, (first, last))
                yield stream.part(first, last), out

    def triangle(self, x: Array, root: Array, noise: tuple[float, ...]) -> Array:
        """The triangle R of [J r] = Q R, over the noise, by QR of chunks, shape (p + 1, p + 1).

        Where parameters can hardly be told from each other: the normal matrix has lost what lies below the root of
        the rounding error.
        """
        p = len(x)
        found = [np.zeros((0, p + 1))]
        for stream in self.streams:
            scale = np.ones(stream.width)
            scale[:3] = 1.0 / noise[stream.lengths]
            scale[3:] = 1.0 / noise[stream.angles]

            def work(first: int, last: int, stream: Stream = stream, scale: Array = scale) -> Array:
                out = np.empty((last - first, stream.width, p + 1))
                self._rows_of(stream, x, root, out, (first, last))
                return triangle_of((out * scale[:, None]).reshape(-1, p + 1))

            found += in_threads(work, len(stream))
        return triangle_of(np.concatenate(found))

    def _geometry(self, x: Array, *, columns: bool = True) -> Geometry:
        """The chain at x; the last one is remembered, because stages ask for several passes at one x."""
        if self._chains and np.array_equal(self._chains[0][0], x) and columns:
            return self._chains[0][1]
        found = geometry_of(self.kinematics, x, columns=columns)
        if columns:
            self._chains[:] = [(x.copy(), found)]
        return found

    def _normal_of(self, stream: Stream, x: Array, root: Array) -> tuple[Array, Array]:
        """The normal matrices of a stream's lengths and angles."""
        from calib.model import kernel

        geometry, size = self._geometry(x), _tiles(len(x))
        lengths, angles = self._scaled(stream, root)

        def work(first: int, last: int) -> Array:
            H = np.zeros((2, size, size))
            at, count = slice(first, last), last - first
            seen = self._part(stream, x, at)
            kernel.normal(geometry, *seen, lengths[at], angles[at], 0, count, H)
            return H

        H = np.sum(in_threads(work, len(stream)), axis=0)[:, : len(x) + 1, : len(x) + 1]
        of_lengths, of_angles = np.tril(H) + np.tril(H, -1).transpose(0, 2, 1)
        return of_lengths, of_angles

    def _norms_of(
        self,
        stream: Stream,
        x: Array,
        moved: Array,
        root: Array,
        weights: Array,
        noise: tuple[float, ...],
        part: int,
    ) -> Array:
        """The norms of a stream's rows; ``part`` is 0 for all scalars, 1 for lengths, 2 for angles."""
        from calib.model import kernel

        geometry = self._geometry(x)
        lengths, angles = self._scaled(stream, None)
        lengths = fixed(lengths / noise[stream.lengths])
        angles = fixed(angles / noise[stream.angles])
        own, out = stream.own(weights), np.empty(len(stream))
        step, triangle = fixed(moved), fixed(root)

        def work(first: int, last: int) -> None:
            at, count = slice(first, last), last - first
            seen = (*self._part(stream, x, at), lengths[at], angles[at])
            kernel.norms(geometry, *seen, part, step, triangle, own[at], 0, count, out[at])

        in_threads(work, len(stream))
        return out

    def _rows_of(
        self,
        stream: Stream,
        x: Array,
        root: Array | None,
        out: Array,
        span: tuple[int, int] | None = None,
    ) -> None:
        """[J r] of some of a stream's rows in units of sigma times ``root``; r as it is where ``root`` is None."""
        from calib.model import kernel

        geometry = self._geometry(x, columns=root is not None)
        begin, end = (0, len(stream)) if span is None else span
        if root is None:
            lengths = angles = fixed(np.ones(len(stream)))
        else:
            lengths, angles = self._scaled(stream, root)

        def work(first: int, last: int) -> None:
            at = slice(begin + first, begin + last)
            seen = self._part(stream, x, at, columns=root is not None)
            there = out[first:last]
            kernel.rows(geometry, *seen, lengths[at], angles[at], 0, last - first, there)

        in_threads(work, end - begin)

    def _scaled(self, stream: Stream, root: Array | None) -> tuple[Array, Array]:
        """``root`` over the standard deviations of a stream's lengths and of its angles."""
        own = 1.0 if root is None else stream.own(root)
        lengths = fixed(own / stream.own(self.rows.sigma))
        if stream.angles < 0:
            return lengths, lengths
        return lengths, fixed(own / stream.own(self.rows.sigma_angle))

    def _part(
        self, stream: Stream, x: Array, at: slice, *, columns: bool = True
    ) -> tuple[Stood, Stood, Measured]:
        """Where the robot stood in some rows of a stream, and in their partners, and what was measured."""
        k, m = self.kinematics, stream.measured
        stood = stood_at(k, x, stream.samples.select(at), columns=columns)
        other = stood
        if stream.other is not None:
            other = stood_at(k, x, stream.other.select(at), columns=columns)
        return (
            stood,
            other,
            m._replace(points=m.points[at], rotations=m.rotations[at], lengths=m.lengths[at]),
        )


def _tiles(p: int) -> int:
    """The rows of p columns and a residual, in whole tiles of the kernel."""
    return (p + 4) // 4 * 4
