"""The camera that a file states, or that is guessed, and what is said of it."""

from dataclasses import replace
from pathlib import Path

from tisfm.camera import Camera
from tisfm.camera_file import doubt_of, read_camera
from tisfm.cli.console import tell
from tisfm.focal_guess import at_size, guess_focal


def stated_camera(file: Path, shape: tuple[int, int] | None) -> Camera:
    """Return the camera in a file for frames of a shape; say so if it is not to be relied on."""
    camera = read_camera(file, shape)
    doubt = doubt_of(file)
    if doubt:
        tell(f"{file}: {doubt}")
    return camera


def guessed_camera(camera: Camera, first: Path | tuple[int, ...]) -> Camera:
    """Return the camera with a focal length guessed by the first frame, or its shape; say so."""
    guess = guess_focal(first)
    told = f"{guess.focal:.0f} px{at_size(guess.shape)}, {guess.reason}"
    tell(f"focal length guessed: {told}; give --focal if known")
    return replace(camera, focal=guess.focal)
