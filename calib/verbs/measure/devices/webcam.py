"""A reader of a camera at this machine: a sharp picture when it is asked for one."""

from __future__ import annotations

from calib.basics.files import make_folder, write_atomically
from calib.boards.video import Video
from calib.errors import DeviceError
from calib.verbs.measure.devices.reading import Context, Reading


class WebcamReader:
    """Gives a new picture at each call, in the folder ``pictures`` of the session."""

    def __init__(self, argument: str, context: Context) -> None:
        if not argument:
            raise DeviceError("The reader 'webcam' needs the number of a camera: webcam:0")
        self._video = Video(argument)
        self._folder = context.folder / "pictures"
        self._count = 0

    def read(self, timeout: float | None = None) -> Reading | None:  # noqa: ARG002  a camera does not wait
        """Take a picture, write it as a file, and return its name.

        Args:
            timeout: Not used: a picture is there at once.

        Returns:
            The picture.

        Raises:
            DeviceError: The camera gives none.
            FileError: It cannot be written.
        """
        data = self._video.picture()
        make_folder(self._folder)
        path = self._folder
        while path.exists():
            self._count += 1
            path = self._folder / f"webcam_{self._count:04d}.png"
        write_atomically(path, data, overwrite=False)
        return Reading(pictures=(path,), source=path.name)

    def close(self) -> None:
        """Give the camera back to other programs."""
        self._video.close()
