"""The camera that a file states, and what the file says against it."""

from pathlib import Path

from tisfm.camera import Camera
from tisfm.camera_file import doubt_of, read_camera
from tisfm.cli.console import tell


def stated_camera(file: Path, shape: tuple[int, int] | None) -> Camera:
    """Return the camera in a file for frames of a shape; say so if it is not to be relied on."""
    camera = read_camera(file, shape)
    doubt = doubt_of(file)
    if doubt:
        tell(f"{file}: {doubt}")
    return camera
