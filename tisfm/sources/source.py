"""The frames of any source, one after the other, and the pairs of consecutive frames."""

import glob
import os
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera
from tisfm.errors import InputError, InputTypeError
from tisfm.formats import IMAGE_SUFFIXES
from tisfm.frames import in_unit_range
from tisfm.sources.arrays import Arrays
from tisfm.sources.crop_resize import CropResize
from tisfm.sources.frame_reader import (
    BadFrame,
    FrameReader,
    Listing,
    RawFrame,
    SourceFrame,
    is_integer,
    is_path,
)
from tisfm.sources.image_files import ImageFiles, count_frames
from tisfm.sources.labels import VOID, LabelReader, Labels, LabelSource
from tisfm.sources.masks import Mask, MaskReader, Masks
from tisfm.sources.pairs import Digest, FramePair
from tisfm.sources.paths import (
    list_images,
    match_pattern,
    order_notes,
    refuse_numbered_pattern,
    refuse_url,
)
from tisfm.sources.read_ahead import read_ahead
from tisfm.sources.video import open_video
from tisfm.sources.webcam import Webcam, webcam_number

Source = str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | Iterable[npt.ArrayLike]
BadFrames = Literal["raise", "skip"]


class FrameSource:
    """A source of frames, checked when it is constructed and read while it is iterated.

    A thread reads and decodes image files and videos ahead; arrays are used in the caller's thread.

    Parameters
    ----------
    source : path, sequence of paths, or iterable of arrays
        A folder of images (in natural order of their names, without hidden files), a glob pattern,
        a video file, a list of image files, or any iterable of (H, W) or (H, W, 3) arrays. A camera
        is ``"webcam"``, ``"webcam:1"``, …
    step : int
        Take every `step`-th frame.
    start, stop : int
        Number, from 0, of the first frame to take, and number after the last frame to take. By
        default all frames.
    size : int, optional
        Longer side of the frames, px. Larger frames are shrunk by averaging over areas.
    crop : (int, int, int, int), optional
        Left, top, width and height of the crop, px. Frames are cropped before they are shrunk.
    mask : path, array, sequence of paths, or iterable of arrays, optional
        Pixels that are black, zero or False are ignored. One mask for all frames, an image file or
        an array, or one mask for every frame, as for `tisfm.sources.masks.Masks`. Masks have the
        size of the frames before cropping and shrinking.
    labels : path, array, sequence, mapping, or iterable, optional
        Numbers of moving objects, as for `tisfm.sources.labels.Labels`: 0 for the background at
        rest, 1 to 254 for objects, 255 for ignored pixels. Labels have the size of the frames
        before cropping and shrinking, or after both.
    bad_frames : {"raise", "skip"}
        Whether a damaged frame raises an error or is skipped.

    Attributes
    ----------
    files : tuple of Path
        All files of the source: the video, or the images, including images that `step` leaves out;
        the masks and the labels.
    names : tuple of str or None
        Names of the frames that are taken, if each frame has a file.
    prefix : str
        Prefix of the names of numbered frames.
    count : int or None
        Number of all frames of the source. None if it is unknown before reading: a video may state
        a frame or two too many.
    selection : slice
        Start, stop and step.
    bad_frames : {"raise", "skip"}
        The argument.
    times : tuple of float or None
        Times of the frames that are taken, s, if they are known before reading.
    notes : tuple of str
        Notes to the user: files or streams that are left out, frames that are resampled, how
        ambiguous file names are read.
    skipped : list of (int, str)
        Numbers of the damaged frames that were skipped so far, each with the reason.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a pattern matches nothing.
    OSError
        If a camera cannot be opened, or a path leads to a device or a pipe.
    TypeError
        If the source is of another type.
    ValueError
        If there are fewer than two frames, or the value of an argument is not allowed.
    """

    def __init__(
        self,
        source: Source,
        *,
        step: int = 1,
        start: int = 0,
        stop: int | None = None,
        size: int | None = None,
        crop: tuple[int, int, int, int] | None = None,
        mask: Mask | None = None,
        labels: LabelSource | None = None,
        bad_frames: BadFrames = "raise",
    ) -> None:
        self.selection = _check_selection(start, stop, step)
        if bad_frames not in get_args(BadFrames):
            raise InputError(f'bad_frames is {bad_frames!r}: expected "raise" or "skip"')
        self.bad_frames = bad_frames
        self._crop_resize = CropResize(crop=crop, size=size)
        reader = _open(source)
        self._reader = reader
        for number in (reader.count, reader.stated_count):
            if number is not None:
                self._check_count(number)
        self.title, self.prefix, self.count = reader.title, reader.prefix, reader.count
        self.names = None if reader.names is None else reader.names[self.selection]
        self.files, self.notes = reader.files, reader.notes
        self.times = None if reader.times is None else reader.times[self.selection]
        self._masks: Masks | None = None
        if mask is not None:
            frame_files = () if reader.names is None else reader.files
            self._masks = Masks(mask, frame_files=frame_files, count=reader.count)
            self.files += self._masks.files
        self._labels: Labels | None = None
        if labels is not None:
            self._labels = Labels(
                labels,
                names=reader.names,
                frame_files=() if reader.names is None else reader.files,
                prefix=reader.prefix,
                count=reader.count,
            )
            self.files += self._labels.files
        self.skipped: list[tuple[int, str]] = []
        self._may_lack_pairs = False

    @property
    def has_labels(self) -> bool:
        """Whether labels are given, at least of some frames."""
        return self._labels is not None

    @property
    def frame_files(self) -> tuple[Path, ...]:
        """Files of the frames: all images of the source, or the video file."""
        return self._reader.files

    @property
    def mask_files(self) -> tuple[Path, ...]:
        """Files of the masks."""
        return () if self._masks is None else self._masks.files

    @property
    def first_file(self) -> Path | None:
        """The image file of the first frame that was not skipped; None for other sources."""
        if self.names is None:
            return None
        skipped = {index for index, _ in self.skipped}
        indices = range(len(self._reader.files))[self.selection]
        return next((self._reader.files[index] for index in indices if index not in skipped), None)

    @property
    def listing(self) -> Listing:
        """The files of the frames in this process, up to the last frame to take."""
        files = self.frame_files
        if self.names is None:  # the size shows whether a video is still being copied
            return Listing.from_files(files, with_sizes=True)
        return Listing.from_files(files[: self.selection.stop])

    def allow_no_pairs(self) -> None:
        """Allow a source without a pair, such as the rest of a sequence that had pairs."""
        self._may_lack_pairs = True

    def __len__(self) -> int:
        """Return the number of pairs if it is known before reading, else raise TypeError.

        Skipped frames reduce the number of pairs.
        """
        count = self._reader.stated_count if self.count is None else self.count
        if count is None:
            raise InputTypeError(f"the length of {self.title} is not known before it is read")
        return max(0, len(range(count)[self.selection]) - 1)

    def __iter__(self) -> Generator[FramePair, None, None]:
        """Read the frames, and yield each pair of consecutive frames."""
        previous: tuple[SourceFrame, Digest] | None = None
        pair_count = 0
        with closing(self.frames()) as frames:
            for frame in frames:
                digest = Digest(frame.image)
                if previous is not None:
                    frame0, digest0 = previous
                    times = None
                    if frame0.time is not None and frame.time is not None:
                        times = frame0.time, frame.time
                    yield FramePair(
                        name0=frame0.name,
                        frame0=frame0.image,
                        name1=frame.name,
                        frame1=frame.image,
                        scales_unit_range=frame.scales_unit_range,
                        full_shape=frame.full_shape,
                        times=times,
                        ignored0=frame0.ignored,
                        ignored1=frame.ignored,
                        interval=frame.index - frame0.index,
                        index=frame0.index,
                        _digests=(digest0, digest),
                    )
                    del frame0, digest0  # free their memory before the next frame is read
                    pair_count += 1
                previous = frame, digest
        if pair_count == 0 and not self._may_lack_pairs:
            skipped = f" ({len(self.skipped)} were skipped)" if self.skipped else ""
            raise InputError(
                f"{self.title} ended before there was a pair{skipped}: expected more frames"
            )

    def frames(self) -> Generator[SourceFrame, None, None]:
        """Read the frames, one after the other.

        To end the thread that reads ahead, exhaust or close the generator.

        Raises OSError, tisfm.formats.FormatError if a frame cannot be read; for a damaged frame
        only with ``bad_frames="raise"``.

        Raises TypeError, ValueError if frames differ in size, do not contain the crop, or have no
        mask of their size; if labels are of a wrong type; if a video is cut off.
        """
        self.skipped = []
        prepared_frames = self._prepare_frames()
        can_read_ahead = all(
            item is None or item.can_read_ahead
            for item in (self._reader, self._masks, self._labels)
        )
        scales_unit_range = True
        with closing(read_ahead(prepared_frames) if can_read_ahead else prepared_frames) as frames:
            for frame in frames:
                if isinstance(frame, BadFrame):
                    if self.bad_frames == "raise":
                        raise frame.error
                    self.skipped.append((frame.index, str(frame.error)))
                    continue
                scales_unit_range = scales_unit_range and in_unit_range(frame.image)
                yield replace(frame, scales_unit_range=scales_unit_range)

    def camera_after(
        self,
        camera: Camera,  # camera of the frames before cropping and shrinking
        # height and width of the frames before cropping and shrinking, px: the attribute
        # `full_shape` of a frame or pair
        full_shape: tuple[int, int] | None,
    ) -> Camera:
        """Return the camera of the cropped and shrunk frames."""
        return camera if full_shape is None else self._crop_resize.camera_after(camera, *full_shape)

    def _prepare_frames(self) -> Generator[BadFrame | SourceFrame, None, None]:
        """Yield frames, cropped and shrunk, with their masks and labels; also damaged frames."""
        masks = None if self._masks is None else self._masks.reader()
        labels = None if self._labels is None else self._labels.reader()
        previous: tuple[str, tuple[int, ...]] | None = None  # name and shape of the frame before
        for raw_frame in self._reader.read(self.selection):
            if isinstance(raw_frame, BadFrame):
                yield raw_frame
                continue
            if previous is not None and raw_frame.image.shape != previous[1]:
                raise InputError(
                    f"frames {previous[0]} and {raw_frame.name}: the first is {previous[1]}, the "
                    f"second {raw_frame.image.shape}, but they must have the same size and channels"
                )
            previous = raw_frame.name, raw_frame.image.shape
            yield self._prepare(raw_frame, masks, labels)
            del raw_frame  # free its memory before the next frame is read
        if labels is not None:
            labels.check()

    def _prepare(
        self, raw_frame: RawFrame, masks: MaskReader | None, given_labels: LabelReader | None
    ) -> SourceFrame:
        """Return a frame, cropped and shrunk, with its mask and labels."""
        image, full_shape = raw_frame.image, None
        if not self._crop_resize.keeps_frames:
            image, full_shape = self._crop_resize.apply(image, raw_frame.name), image.shape[:2]
        ignored = None
        if masks is not None:
            ignored = masks.read_ignored(raw_frame.index, raw_frame.name, raw_frame.image.shape)
            ignored = self._crop_resize.apply_to_mask(ignored, raw_frame.name)
        labels = None
        if given_labels is not None:
            labels = given_labels.read_labels(
                raw_frame.index, raw_frame.name, (raw_frame.image.shape, image.shape)
            )
        if labels is not None:
            is_void = labels == VOID
            labels = np.where(is_void, np.uint8(0), labels)
            if labels.shape != image.shape[:2]:
                is_void = self._crop_resize.apply_to_mask(is_void, raw_frame.name)
                labels = self._crop_resize.apply_to_labels(labels, raw_frame.name)
            if is_void.any():
                ignored = is_void if ignored is None else ignored | is_void
        return SourceFrame(
            index=raw_frame.index,
            name=raw_frame.name,
            time=raw_frame.time,
            image=image,
            ignored=ignored,
            labels=labels,
            full_shape=full_shape,
        )

    def _check_count(self, count: int) -> None:
        min_count = self.selection.start + self.selection.step + 1
        if count >= min_count:
            return
        if count == 1 and len(self._reader.files) == 1 and self._reader.names is not None:
            _refuse_animation(self._reader.files[0])
        raise InputError(
            f"{self._reader.title} has {count} frame{'s' * (count != 1)}: expected at least "
            f"{min_count}, to make a pair"
        )


def _refuse_animation(file: Path) -> None:
    """Raise ValueError if an image file has several frames, because only the first can be read."""
    count = count_frames(file)
    if count > 1 and file.suffix.lower() == ".gif":
        raise InputError(
            f"{file} is a GIF of {count} frames, which is read as a video: give its path, not a "
            "folder or a pattern"
        )
    if count > 1:
        raise InputError(
            f"{file} is a picture of {count} frames, of which only the first can be read: save "
            "the frames as separate files, for instance by "
            f"`magick {file} -coalesce frame%03d.png` of ImageMagick, and give their folder"
        )


def _check_selection(start: int, stop: int | None, step: int) -> slice:
    """Check start, stop and step; return them as a slice."""
    for name, value, min_value, expected in (
        ("step", step, 1, "a positive integer"),
        ("start", start, 0, "the number of a frame, from 0"),
    ):
        if not is_integer(value) or value < min_value:
            raise InputError(f"{name} is {value!r}: expected {expected}")
    if stop is not None and (not is_integer(stop) or stop < start + step + 1):
        raise InputError(
            f"stop is {stop!r}: expected at least {start + step + 1}, to make a pair of frames "
            f"from {start} on"
        )
    return slice(int(start), None if stop is None else int(stop), int(step))


def _open(source: Source) -> FrameReader:
    """Return the reader of a source."""
    if isinstance(source, (str, os.PathLike)):
        return _open_path(os.fspath(source))
    if isinstance(source, Sequence) and source and all(map(is_path, source)):
        files = [Path(item) for item in source]
        return ImageFiles(files, "frames", order_notes(files))
    return Arrays(source)


def _open_path(source: str) -> FrameReader:
    if os.path.isdir(source):
        images = list_images(source)
        return ImageFiles(images.files, source, images.notes)
    if os.path.isfile(source):
        if source.lower().endswith(IMAGE_SUFFIXES):
            return ImageFiles([Path(source)], source)
        return open_video(source)
    refuse_url(source)
    if os.path.exists(source):
        raise OSError(f"{source} is a device or a pipe, not a file: save its data to a file first")
    refuse_numbered_pattern(source)
    if glob.has_magic(source):
        images = match_pattern(source)
        return ImageFiles(images.files, source, images.notes)
    number = webcam_number(source)
    if number is not None:
        return Webcam(number)
    raise FileNotFoundError(f"there is no file or folder {source}: check the path")
