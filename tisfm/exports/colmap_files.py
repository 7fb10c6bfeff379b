"""The files of a model, as pycolmap writes them, and whether all of them is there.

pycolmap says nothing where a disk is full, and does not come to an end with what is left then.
"""

from pathlib import Path
from typing import Any, Literal

Form = Literal["binary", "text", "both"]


def write_model(model: Any, folder: Path, form: Form) -> None:
    """Write a reconstruction of pycolmap, of one camera and frames of one image.

    Parameters
    ----------
    model : pycolmap.Reconstruction
    folder : Path
        Made here.
    form : {"binary", "text", "both"}

    Raises
    ------
    OSError
        If a file was not written to its end.
    """
    folder.mkdir(parents=True)
    if form != "text":
        model.write_binary(folder)
    if form != "binary":
        model.write_text(folder)
    check_whole(model, folder, form)


def check_whole(model: Any, folder: Path, form: Form) -> None:
    """Raise OSError unless files of a model have all bytes, or all lines."""
    if form != "text":
        for name, size in _sizes(model).items():
            _require((folder / name).stat().st_size == size, folder / name)
    if form != "binary":
        for name, rows in _rows(model).items():
            _require(_rows_of(folder / name) == rows, folder / name)


def _require(whole: bool, path: Path) -> None:
    if not whole:
        raise OSError(f"{path} was not written to its end: is the disk full?")


def _sizes(model: Any) -> dict[str, int]:
    """Return lengths of the binary files, bytes: each begins with a count of 8."""
    images = sum(
        4 + 56 + 4 + len(image.name) + 1 + 8 + 24 * image.num_points2D()
        for image in model.images.values()
    )
    points = sum(51 + 8 * point.track.length() for point in model.points3D.values())
    return {
        "cameras.bin": 8 + 24 + 8 * 4,
        "rigs.bin": 8 + 16,
        "frames.bin": 8 + 84 * model.num_images(),
        "images.bin": 8 + images,
        "points3D.bin": 8 + points,
    }


def _rows(model: Any) -> dict[str, int]:
    """Return how many lines the texts have that are no comments."""
    images = model.num_images()
    return {
        "cameras.txt": 1,
        "rigs.txt": 1,
        "frames.txt": images,
        "images.txt": 2 * images,
        "points3D.txt": model.num_points3D(),
    }


def _rows_of(path: Path) -> int:
    """Return how many lines of a text are no comments and have an end."""
    with path.open("rb") as file:
        return sum(line.endswith(b"\n") and not line.startswith(b"#") for line in file)
