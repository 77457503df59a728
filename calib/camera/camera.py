"""Cameras: the size of the image, the lens model, the intrinsics, and how accurately these are known."""

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

#: Standard deviation of an intrinsic that is unknown.
UNKNOWN = np.inf

#: The longest side of an image [px].
_LARGEST = 100_000

_PIXELS = form(
    "a whole number of pixels, such as 1280",
    lambda value: value if isinstance(value, int) and not isinstance(value, bool) else None,
)

#: Intrinsics are those of another resolution if their centre is off the middle by more than this share of the image's
#: size, and by nearly the same factor along both axes: within this, relatively.
_OFF_CENTRE = 0.1
_ALIKE = 0.1


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Camera(Value):
    """A camera: z along the line of sight, x to the right and y down in the image, as OpenCV and ROS have it.

    The centre of the pixel in the image's upper left corner is (0, 0).

    Raises:
        CalibError: An unknown lens, an image without pixels, or intrinsics that no lens has.
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
        "Lens model: OpenCV's five coefficients (pinhole; ROS: plumb_bob), eight (rational; ROS: rational_polynomial), "
        "or fourteen (tilted: with a thin prism and a tilted sensor), or cv2.fisheye (fisheye; ROS: equidistant).",
        default="pinhole",
    )
    #: The intrinsics in the order of ``LENSES[lens].names``: fx, fy, cx, cy [px], then distortion, shape (m,). None:
    #: they are unknown, and estimated from the images.
    values: Array | None = None
    #: Standard deviation of each, in its unit, shape (m,): 0 for one that is exact, `UNKNOWN` for one that is not
    #: known. None: the default for a camera whose intrinsics are given, see `calib.camera.lenses.Lens.default_sigma`.
    sigma: Array | None = None
    #: Intrinsics, in the same order, from which a fit begins if none are given; None: it finds them in the images.
    start: Array | None = None

    def __post_init__(self) -> None:
        """Check the image's size, the lens and the intrinsics (`CalibError`), and keep read-only copies of these."""
        for side in ("width", "height"):
            given = getattr(self, side)
            try:
                pixels = operator.index(given)
            except TypeError:
                pixels = 0
            if isinstance(given, bool) or not 0 < pixels <= _LARGEST:
                raise CalibError(
                    f"{self._title} has the image {side} {given!r}; it must be a whole number of pixels from 1 to "
                    f"{_LARGEST}, such as {1280 if side == 'width' else 720}."
                )
            object.__setattr__(self, side, pixels)
        if not isinstance(self.lens, str) or self.lens not in LENSES:
            raise CalibError(
                f"{self._title} has the lens '{self.lens}'{did_you_mean(self.lens, LENSES)}; allowed are "
                f"{choices(LENSES)}."
            )
        if self.values is not None:
            values = self._numbers("values", self.values)
            object.__setattr__(self, "values", values)
            if not np.all(np.isfinite(values)):
                raise CalibError(
                    f"{self._title} has a number of its lens that is not finite: {values.tolist()}."
                )
            if np.any(values[:2] <= 0.0):
                fx, fy = values[:2].tolist()
                raise CalibError(
                    f"{self._title} has the focal lengths fx = {fx:g} and fy = {fy:g}; both must be above 0 [px]."
                )
        if self.sigma is not None:
            sigma = self._numbers("sigma", self.sigma)
            object.__setattr__(self, "sigma", sigma)
            if self.values is None:
                raise CalibError(
                    f"{self._title} has standard deviations but no numbers of its lens; give both or none."
                )
            if not np.all(sigma >= 0.0):
                raise CalibError(
                    f"{self._title} has the standard deviations {sigma.tolist()}; each must be 0 (exact), above, or "
                    "infinite (not known)."
                )

    @property
    def _title(self) -> str:
        """Beginning of a message about the camera: ``"The camera 'NAME'"``."""
        return f"The camera '{self.name}'"

    def _numbers(self, what: str, given: object) -> Array:
        """Return ``given``, numbers for the m intrinsics, as a read-only array (m,); CalibError for another shape."""
        names = LENSES[self.lens].names
        try:
            array = np.array(given, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise CalibError(
                f"{self._title} has {what} that are not numbers: {given!r}."
            ) from error
        if array.shape != (len(names),):
            raise CalibError(
                f"{self._title} has {what} of the shape {array.shape}; a lens '{self.lens}' has {len(names)} numbers: "
                f"{', '.join(names)}."
            )
        array.setflags(write=False)
        return array

    def with_name(self, name: str) -> Camera:
        """Return the camera with another name."""
        return replace(self, name=name)

    @property
    def likely_size(self) -> tuple[int, int] | None:
        """Width and height [px] of the images that the intrinsics seem to belong to; None if nothing contradicts these.

        The centre of a lens is near the middle of its images. If it is not, but is off by the same factor along both
        axes, the intrinsics are those of another resolution.
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
