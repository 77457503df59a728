"""Cameras: the size of the image, the lens model, its numbers, and how well these are known."""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array
from calib.basics.records import key
from calib.basics.value_forms import TEXT, form, one_of
from calib.basics.values import Value
from calib.camera.lenses import LENSES
from calib.errors import CalibError, choices, did_you_mean

#: Standard deviation of a number of which nothing is known.
UNKNOWN = np.inf

#: The longest side of an image [px].
_LARGEST = 100_000

_PIXELS = form(
    "a whole number of pixels, such as 1280",
    lambda value: value if isinstance(value, int) and not isinstance(value, bool) else None,
)

#: A centre this far from the middle, over the image's size, and as far along both axes, is that of another size.
_OFF_CENTRE = 0.1
_ALIKE = 0.1


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Camera(Value):
    """A camera: z along the line of sight, x to the right and y down in the image, as OpenCV and ROS have it.

    The centre of the pixel in the image's upper left corner is (0, 0).

    Raises:
        CalibError: An unknown lens, an image without pixels, or numbers that are no lens's.
    """

    #: Name, as in the column ``group`` of a table of corners.
    name: str = key("name", TEXT, "Name of the camera, for messages.", default="camera")
    #: Columns of the image [px].
    width: int = key("width", _PIXELS, "Width of the images.", json="width_px")
    #: Rows of the image [px].
    height: int = key("height", _PIXELS, "Height of the images.", json="height_px")
    #: A name of `calib.camera.lenses.LENSES`.
    lens: str = key(
        "lens",
        one_of(tuple(LENSES)),
        "Lens model: OpenCV's five coefficients (pinhole; ROS: plumb_bob), or cv2.fisheye (fisheye; ROS: equidistant).",
        default="pinhole",
    )
    #: The lens's numbers in the order of ``LENSES[lens].names``: fx, fy, cx, cy [px], then distortion, shape (m,).
    #: None: nothing of them is known, and the images tell.
    values: Array | None = None
    #: Standard deviation of each, in its unit, shape (m,): 0 for one that is exact, `UNKNOWN` for one that is not
    #: known. None: the default of a camera whose numbers are given, see `calib.camera.lenses.Lens.default_sigma`.
    sigma: Array | None = None

    def __post_init__(self) -> None:
        """Check the numbers, and keep read-only copies of them."""
        for side in ("width", "height"):
            object.__setattr__(self, side, self._side(side))
        if not isinstance(self.lens, str) or self.lens not in LENSES:
            raise CalibError(
                f"{self._title} has the lens '{self.lens}'{did_you_mean(self.lens, LENSES)}; allowed are "
                f"{choices(LENSES)}."
            )
        if self.values is not None:
            object.__setattr__(self, "values", self._numbers("values", self.values))
            self._check_values()
        if self.sigma is not None:
            object.__setattr__(self, "sigma", self._numbers("sigma", self.sigma))
            self._check_sigma()

    @property
    def _title(self) -> str:
        """The camera as messages name it."""
        return f"The camera '{self.name}'"

    def _side(self, side: str) -> int:
        """Return the image's width or height as an int."""
        given = getattr(self, side)
        try:
            pixels = operator.index(given)
        except TypeError:
            pixels = 0
        if isinstance(given, bool) or not 0 < pixels <= _LARGEST:
            raise CalibError(
                f"{self._title} has images of a {side} of {given!r}; it must be a whole number of pixels from 1 to "
                f"{_LARGEST}, such as {1280 if side == 'width' else 720}."
            )
        return pixels

    def _numbers(self, what: str, given: object) -> Array:
        """Return an entry for each of the lens's numbers, shape (m,), as a read-only copy.

        Args:
            what: The attribute, for messages.
            given: Its value as given.
        """
        names = LENSES[self.lens].names
        try:
            array = np.array(given, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise CalibError(f"{self._title} has {what} that are no numbers: {given!r}.") from error
        if array.shape != (len(names),):
            raise CalibError(
                f"{self._title} has {what} of the shape {array.shape}; a lens '{self.lens}' has {len(names)} numbers: "
                f"{', '.join(names)}."
            )
        array.setflags(write=False)
        return array

    def _check_values(self) -> None:
        """Refuse numbers that are not finite, and focal lengths that are not above zero."""
        assert self.values is not None
        if not np.all(np.isfinite(self.values)):
            raise CalibError(
                f"{self._title} has a number of its lens that is not finite: {self.values.tolist()}."
            )
        if np.any(self.values[:2] <= 0.0):
            fx, fy = self.values[:2].tolist()
            raise CalibError(
                f"{self._title} has the focal lengths fx = {fx:g} and fy = {fy:g}; both must be above 0 [px]."
            )

    def _check_sigma(self) -> None:
        """Refuse standard deviations of nothing, and negative ones."""
        assert self.sigma is not None
        if self.values is None:
            raise CalibError(
                f"{self._title} has standard deviations but no numbers of its lens; give both or none."
            )
        if not np.all(self.sigma >= 0.0):
            raise CalibError(
                f"{self._title} has the standard deviations {self.sigma.tolist()}; each must be 0 (exact), above, or "
                "infinite (not known)."
            )

    def with_name(self, name: str) -> Camera:
        """Return the camera with another name."""
        return replace(self, name=name)

    @property
    def likely_size(self) -> tuple[int, int] | None:
        """Width and height of the images that the numbers are of, where these are hardly those of this size [px].

        The centre of a lens is near the middle of its images. Where it is not, but is off by the same factor along both
        axes, the numbers are those of another resolution. None where nothing speaks for that.
        """
        if self.values is None:
            return None
        size = np.array([self.width, self.height])
        factors = (2.0 * self.values[2:4] + 1.0) / size
        if (
            np.min(np.abs(factors - 1.0)) < 2.0 * _OFF_CENTRE
            or np.ptp(factors) > _ALIKE * factors[0]
        ):
            return None
        width, height = np.rint(size * np.mean(factors)).astype(int).tolist()
        return width, height
