"""Pictures of a camera or of a film, taken while it runs: the sharpest one of several."""

from __future__ import annotations

from calib.boards.opencv import opencv
from calib.errors import DeviceError

#: Pictures that a camera has taken before it was asked, which its driver still holds.
_STALE = 5

#: Pictures of which the sharpest is taken.
_TAKEN = 6


class Video:
    """A camera by its number, or a film by its file."""

    def __init__(self, source: str) -> None:
        """Open it; DeviceError if there is none."""
        self._source = source
        is_camera = source.isascii() and source.isdigit()
        self._capture = opencv().VideoCapture(int(source) if is_camera else source)
        if not self._capture.isOpened():
            remedy = "Check its number, and that no other program has it"
            raise DeviceError(
                f"The camera '{source}' cannot be opened. {remedy if is_camera else 'Check the name'}."
            )

    def picture(self) -> bytes:
        """Return the sharpest of the next pictures as the bytes of a PNG file.

        Sharpness is the variance of the Laplacian of the grey values.

        Raises:
            DeviceError: The camera gives no picture, or the film has ended.
        """
        cv2 = opencv()
        for _ in range(_STALE):
            self._capture.grab()
        sharpest, best = -1.0, None
        for _ in range(_TAKEN):
            is_taken, frame = self._capture.read()
            if not is_taken:
                break
            grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
            sharpness = float(cv2.Laplacian(grey, cv2.CV_64F).var())
            if sharpness > sharpest:
                sharpest, best = sharpness, frame
        if best is None:
            raise DeviceError(
                f"The camera '{self._source}' gives no picture. Check its cable; a film has ended."
            )
        _, data = cv2.imencode(".png", best)
        encoded: bytes = data.tobytes()
        return encoded

    def close(self) -> None:
        """Give the camera back."""
        self._capture.release()
