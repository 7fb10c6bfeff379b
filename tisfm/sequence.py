"""Frames in, interpretations out, two frames in memory at a time."""

import glob
import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera, check_camera
from tisfm.checks import unmasked
from tisfm.focal_guess import guess_camera
from tisfm.frames import in_unit_range
from tisfm.interpretation import Interpretation
from tisfm.settings import Settings, check_settings

Source = str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | Iterable[npt.ArrayLike]


@dataclass(frozen=True, kw_only=True)
class FramePair:
    """Two consecutive frames of a source, with their names (file stems, or frame numbers).

    The pose, if there is one, is a known motion as for `tisfm.interpret`. `stretch` is False where
    the frames so far show that float frames of the source are on the 8-bit scale, though those of
    this pair may look as if they were in [0, 1].
    """

    name0: str
    name1: str
    frame0: np.ndarray
    frame1: np.ndarray
    pose: npt.ArrayLike | None = None
    stretch: bool = True
    _digests: tuple["_Digest", "_Digest"] | None = field(default=None, repr=False, compare=False)

    def interpret(
        self, *, camera: Camera | None = None, settings: Settings | None = None
    ) -> Interpretation:
        """Interpret the pair; errors name its frames."""
        from tisfm.pair import interpret, interpret_pair

        work = interpret if self.stretch else partial(interpret_pair, stretch=False)
        try:
            return work(self.frame0, self.frame1, camera=camera, settings=settings, pose=self.pose)
        except (TypeError, ValueError) as error:
            error.args = (f"frames {self.name0} and {self.name1}: {error}",)
            raise

    @property
    def digest(self) -> str:
        """A short hash of both frames, and of the pose if there is one, to know them again by."""
        both = hashlib.blake2b(digest_size=8)
        for frame in self._digests or (_Digest(self.frame0), _Digest(self.frame1)):
            both.update(frame.value)
        if self.pose is not None:
            both.update(np.array(self.pose, np.float64).tobytes())
        return both.hexdigest()


class _Digest:
    """The hash of a frame, computed once though the frame is in two pairs."""

    def __init__(self, frame: np.ndarray) -> None:
        self._frame: np.ndarray | None = frame
        self._value = b""

    @property
    def value(self) -> bytes:
        """Eight bytes or more that differ between frames."""
        frame = self._frame
        if frame is not None:
            pixels = hashlib.blake2b(f"{frame.shape} {frame.dtype}".encode(), digest_size=16)
            pixels.update(np.ascontiguousarray(frame).reshape(-1).data)
            self._value, self._frame = pixels.digest(), None
        return self._value


class FrameSource:
    """A source of frames, checked when it is made and read as it is iterated.

    Parameters
    ----------
    source : path, sequence of paths, or iterable of arrays
        A folder of images (in natural order of their names, hidden files apart), a glob pattern,
        a video file, a list of image files, or any iterable of (H, W) or (H, W, 3) arrays.
    step : int
        Take every `step`-th frame.

    Attributes
    ----------
    first_file : Path or None
        The image file of the first frame, where frames have files of their own.
    files : tuple of Path
        All files of the source: the images, those between the steps included, or the video.
    names : tuple of str or None
        Names of the frames that are read, where frames have files of their own.
    count : int or None
        Number of frames, those between the steps included. None where only reading tells: a video
        may announce a frame or two too many.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a pattern matches nothing.
    TypeError
        If the source is none of these.
    ValueError
        If there is only one frame, or none.
    """

    def __init__(self, source: Source, *, step: int = 1) -> None:
        if isinstance(step, bool) or not isinstance(step, (int, np.integer)) or step < 1:
            raise ValueError(f"step is {step!r}: expected a positive integer")
        self.step = int(step)
        self.title = "frames"
        self.first_file: Path | None = None
        self.files: tuple[Path, ...] = ()
        self.names: tuple[str, ...] | None = None
        self.count: int | None = None
        self._announced: int | None = None
        self._frames: Iterable[tuple[str, np.ndarray]]
        if isinstance(source, (str, os.PathLike)):
            self.title = os.fspath(source)
            self._open_path(os.fspath(source))
        elif isinstance(source, Sequence) and source and all(map(_is_path, source)):
            self._use_files([Path(item) for item in source])
        else:
            self._use_arrays(source)

    def __len__(self) -> int:
        """Return the number of pairs, where it is known beforehand; TypeError where not."""
        count = self._announced if self.count is None else self.count
        if count is None:
            raise TypeError(f"the length of {self.title} is not known before it is read")
        return max(0, -(-count // self.step) - 1)

    def __iter__(self) -> Iterator[FramePair]:
        """Read the frames, and yield every pair of consecutive ones."""
        previous: tuple[str, np.ndarray, _Digest] | None = None
        pairs, stretch = 0, True
        for name, frame in self._frames:
            stretch = stretch and in_unit_range(frame)
            digest = _Digest(frame)
            if previous is not None:
                name0, frame0, digest0 = previous
                yield FramePair(
                    name0=name0,
                    frame0=frame0,
                    name1=name,
                    frame1=frame,
                    stretch=stretch,
                    _digests=(digest0, digest),
                )
                del frame0, digest0  # or the frame would be held while the next is read
                pairs += 1
            previous = name, frame, digest
        if pairs == 0:
            raise ValueError(f"{self.title} ended before there was a pair: expected more frames")

    def _open_path(self, source: str) -> None:
        from tisfm.formats import IMAGE_SUFFIXES
        from tisfm.formats.images import natural_order

        if os.path.isdir(source):
            files = [
                file
                for file in Path(source).iterdir()
                if file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith(".")
            ]
            if not files:
                raise FileNotFoundError(
                    f"the folder {source} has no images: expected files ending in "
                    f"{', '.join(IMAGE_SUFFIXES)}"
                )
            self._use_files(sorted(files, key=natural_order))
        elif os.path.isfile(source):
            if source.lower().endswith(IMAGE_SUFFIXES):
                self._use_files([Path(source)])
            else:
                self._use_video(source)
        elif glob.has_magic(source):
            files = [f for f in map(Path, glob.glob(source)) if f.is_file()]
            if not files:
                raise FileNotFoundError(f"no file matches {source}: check the pattern")
            self._use_files(sorted(files, key=natural_order))
        else:
            raise FileNotFoundError(f"there is no file or folder {source}: check the path")

    def _use_files(self, files: list[Path]) -> None:
        for file in files:
            if not file.exists():
                raise FileNotFoundError(f"there is no file {file}: check the path")
        self._check_count(len(files))
        self.count = len(files)
        self.first_file = files[0]
        self.files = tuple(files)
        stems = [file.stem for file in files]
        # Of different folders or suffixes; some file systems take a and A for the same.
        if len({stem.lower() for stem in stems}) < len(stems):
            stems = [f"{index:06d}_{stem}" for index, stem in enumerate(stems)]
        self.names = tuple(stems[:: self.step])
        self._frames = _ImageFiles(files[:: self.step], self.names)

    def _use_video(self, path: str) -> None:
        video = _Video(path, self.step)
        if video.announced is not None:
            self._check_count(video.announced)
            self._announced = video.announced
        self.files = (Path(path),)
        self._frames = video

    def _use_arrays(self, items: Iterable[Any]) -> None:
        if isinstance(items, np.ndarray) and items.ndim not in (3, 4):
            raise ValueError(
                f"frames is {items.shape}: expected (N, H, W) or (N, H, W, 3), or a list of frames"
            )
        if not isinstance(items, Iterable):
            raise TypeError(
                f"source is {items!r}: expected a path, a list of paths, or an iterable of arrays"
            )
        if isinstance(items, (Sequence, np.ndarray)):
            self._check_count(len(items))
            self.count = len(items)
        self._frames = _Arrays(items, self.step)

    def _check_count(self, count: int) -> None:
        if count < self.step + 1:
            raise ValueError(
                f"{self.title} has {count} frame{'s' * (count != 1)}: expected at least "
                f"{self.step + 1}, to make a pair"
            )


def interpret_sequence(
    source: Source,
    *,
    camera: Camera | None = None,
    settings: Settings | None = None,
    step: int = 1,
    poses: Iterable[npt.ArrayLike] | None = None,
) -> Iterator[Interpretation]:
    """Interpret every pair of consecutive frames, one at a time.

    Parameters
    ----------
    source : path, sequence of paths, or iterable of arrays
        A folder of images, a glob pattern, a video, a list of image files, or any iterable of
        frames. Two frames are in memory at a time.
    camera : Camera, optional
        As for `tisfm.interpret`; distortion is removed from every frame first. A focal length that
        has to be guessed is guessed once, from the first image file, or else from the size of the
        first frame, with one `GuessedFocalWarning`.
    settings : Settings, optional
        By default the preset ``"balanced"``.
    step : int
        Take every `step`-th frame, for slow motion.
    poses : iterable of (4, 4) or (3, 3) arrays, optional
        A known motion for every pair, as `pose` for `tisfm.interpret`: from the axes of its first
        frame to those of its second. It may be made as it goes, and need not end.

    Returns
    -------
    iterator of Interpretation
        For frames (0, 1), (1, 2), …

    Raises
    ------
    FileNotFoundError, TypeError, ValueError
        At once if the source does not exist or has fewer than two frames, or if there are poses
        for a motion that is not ``"camera"``, or not as many as pairs; while iterating if a frame
        cannot be read, if the poses end too early, or as `tisfm.interpret`, with the names of the
        frames.
    """
    camera, settings = None if camera is None else check_camera(camera), check_settings(settings)
    frames = FrameSource(source, step=step)
    if poses is not None and settings.motion != "camera":
        raise ValueError(
            f'poses are given, but motion="{settings.motion}" leaves the motion free: leave them '
            "out"
        )
    return _interpret_pairs(with_poses(frames, poses), frames.first_file, camera, settings)


def with_poses(
    pairs: FrameSource, poses: Iterable[npt.ArrayLike] | None, *, title: str = "poses"
) -> Iterator[FramePair]:
    """Give every pair of a source its pose.

    Parameters
    ----------
    pairs : FrameSource
    poses : iterable of array_like, or None
        One for every pair; None for none. They are checked when the pair is interpreted.
    title : str
        What errors call them.

    Returns
    -------
    iterator of FramePair

    Raises
    ------
    TypeError, ValueError
        At once if the poses cannot be iterated or are known not to be as many as the pairs; while
        iterating if they end too early, or are left over though their number is known.
    """
    if poses is None:
        return iter(pairs)
    if isinstance(poses, np.ndarray) and poses.ndim != 3:
        raise ValueError(
            f"{title} is {poses.shape}: expected one for every pair, (N, 4, 4) or (N, 3, 3)"
        )
    if not isinstance(poses, Iterable):
        raise TypeError(f"{title} is {poses!r}: expected a 4×4 or 3×3 array for every pair")
    number = len(poses) if isinstance(poses, Sized) else None
    if pairs.count is not None and number is not None:
        _check_poses(number, len(pairs), title)
    return _posed(pairs, poses, number, title)


def _posed(
    pairs: FrameSource, poses: Iterable[npt.ArrayLike], number: int | None, title: str
) -> Iterator[FramePair]:
    following = iter(poses)
    done = 0
    for pair in pairs:
        try:
            pose = next(following)
        except StopIteration:
            raise ValueError(
                f"{title} ended before frames {pair.name0} and {pair.name1}, after {done}: "
                "expected one for every pair"
            ) from None
        yield replace(pair, pose=pose)
        del pair  # or it would keep its first frame while the next one is read
        done += 1
    if number is not None:
        _check_poses(number, done, title)


def _check_poses(number: int, pairs: int, title: str) -> None:
    if number != pairs:
        raise ValueError(
            f"{title} are {number}, but there {'is' if pairs == 1 else 'are'} {pairs} "
            f"pair{'s' * (pairs != 1)} of frames: expected one for each"
        )


def _interpret_pairs(
    pairs: Iterable[FramePair], first_file: Path | None, camera: Camera | None, settings: Settings
) -> Iterator[Interpretation]:
    for pair in pairs:
        if camera is None and first_file is not None and settings.motion != "field":
            camera = guess_camera(first_file)
        result = pair.interpret(camera=camera, settings=settings)
        camera = camera or result.camera  # a guess is made once
        del pair  # or it would keep its first frame while the next one is read
        yield result
        del result  # of which the frame may be that of the source


class _Arrays:
    """Frames that the caller holds or makes."""

    def __init__(self, items: Iterable[Any], step: int) -> None:
        self._items, self._step = items, step

    def __iter__(self) -> Iterator[tuple[str, np.ndarray]]:
        for index, item in enumerate(islice(self._items, 0, None, self._step)):
            if _is_path(item):
                raise TypeError(
                    f"the source yields {item!r}: expected arrays; give paths as a list, in "
                    "the order of the frames"
                )
            name = f"frame_{index * self._step:06d}"
            # Its mask is refused when the pair is interpreted.
            frame = item if isinstance(item, np.ma.MaskedArray) else unmasked(item, name)
            yield name, frame


class _ImageFiles:
    """Image files, read one after the other."""

    def __init__(self, files: Sequence[Path], names: Sequence[str]) -> None:
        self._files, self._names = files, names

    def __iter__(self) -> Iterator[tuple[str, np.ndarray]]:
        from tisfm.formats import read_image

        for name, file in zip(self._names, self._files, strict=True):
            yield name, read_image(file)


class _Video:
    """A video file, decoded one frame after the other.

    Attributes
    ----------
    announced : int or None
        The number of frames that the file states, if it does.
    """

    def __init__(self, path: str, step: int) -> None:
        self._path, self._step = path, step
        capture = cv2.VideoCapture(self._path)
        try:
            readable = capture.isOpened() and capture.grab()
            self.announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if readable else None
        finally:
            capture.release()
        if not readable:
            raise ValueError(
                f"{path} is not an image or a video that OpenCV can read: it is damaged or of an "
                "unknown format; convert it, for instance to MP4"
            )
        if self.announced is not None and self.announced < 1:
            self.announced = None

    def _read(self, read: Callable[[], Any]) -> Any:
        """Return what OpenCV reads of the file."""
        from tisfm.formats.reading import opencv_memory

        with opencv_memory(self._path):
            return read()

    def __iter__(self) -> Iterator[tuple[str, np.ndarray]]:
        capture = cv2.VideoCapture(self._path)
        stem = Path(self._path).stem
        index = 0
        try:
            while self._read(capture.grab):
                if index % self._step == 0:
                    read, frame = self._read(capture.retrieve)
                    if not read:
                        break
                    yield f"{stem}_{index:06d}", np.ascontiguousarray(frame[..., ::-1])
                index += 1
        finally:
            capture.release()
        # Containers miscount by a frame or two; more means that the file is cut off.
        if self.announced is not None and index < self.announced - max(2, self.announced // 50):
            raise ValueError(
                f"{self._path} ends after {index} of {self.announced} frames: the file is cut "
                "off or damaged; the results up to there are complete"
            )


def _is_path(item: Any) -> bool:
    return isinstance(item, (str, os.PathLike))
