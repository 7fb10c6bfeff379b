"""Reconstruction of a sequence in chunks, from the source to the folder, with resumption."""

import os
import warnings
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy.typing as npt

from tisfm.camera import Camera
from tisfm.camera_file import camera_file_path
from tisfm.errors import InputError, InputTypeError
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.folders.result_folder import (
    locked_folder,
    make_result_folder,
    presence_file,
    remove,
    remove_link,
    remove_temporaries,
    try_to_remove,
)
from tisfm.reconstruction.chunks.chunk import CHUNK, Chunk, check_chunk, spans_of
from tisfm.reconstruction.chunks.joining import ChunkResult, place_chunks, write_whole
from tisfm.reconstruction.chunks.shared_camera import (
    UnorderedMap,
    complete_chunks,
    needs_calibration,
    shared_camera,
)
from tisfm.reconstruction.entry import (
    checked_calibrate,
    checked_camera,
    checked_poses,
    checked_settings,
    refuse_inputs_inside,
)
from tisfm.reconstruction.path.given_poses import poses_of_frames
from tisfm.reconstruction.progress import DepthOf, Progress
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.renewal import CHUNKS, refuse_others, renewed_locked_folder
from tisfm.reconstruction.result.request import (
    is_done,
    make_request,
    read_request,
    refuse_differing_request,
    request_digest,
    write_request,
)
from tisfm.runtime import Arch
from tisfm.settings import Settings
from tisfm.sources import BadFrames, FrameSource, Source
from tisfm.sources.frame_reader import is_path, warn_notes
from tisfm.sources.paths import refuse_url
from tisfm.sources.webcam import webcam_number
from tisfm.status import Status
from tisfm.trajectory import Trajectory
from tisfm.trajectory.times import times_note


class ChunkedRun:
    """A reconstruction in chunks of frames, new or resumed.

    Parameters
    ----------
    source : path, or sequence of paths
        A video, a folder of images, a glob pattern, or image files.
    folder : path
        The folder of the result. Until it is complete, the chunks lie in its ``.tisfm-chunks``.
    camera, calibrate, settings, poses, depth_of, step, start, stop, size, crop, bad_frames
        As for `tisfm.reconstruct`. The settings need ``motion="camera"``.
    mask : path, optional
        As for `tisfm.reconstruct`.
    chunk : int
        Largest number of frames of a chunk.
    arch, threads
        As for `tisfm.runtime.start`, for each process.
    others : mapping, optional
        Further options that the request records, as JSON values.

    Attributes
    ----------
    request : dict
        Everything that the result depends on: the frames and all options.

    Raises
    ------
    OSError, TypeError, ValueError
        As `tisfm.reconstruct`; if the source is a webcam or arrays; if chunks are too short; if the
        settings have ``motion="objects"``.
    """

    def __init__(
        self,
        source: Source,
        folder: str | os.PathLike[str],
        *,
        camera: Camera | str | os.PathLike[str] | None = None,
        calibrate: Calibrate | None = None,
        settings: Settings | None = None,
        poses: npt.ArrayLike | Trajectory | None = None,
        mask: str | os.PathLike[str] | None = None,
        depth_of: DepthOf = "all",
        step: int = 1,
        start: int = 0,
        stop: int | None = None,
        size: int | None = None,
        crop: tuple[int, int, int, int] | None = None,
        bad_frames: BadFrames = "raise",
        chunk: int = CHUNK,
        arch: Arch | None = None,
        threads: int | None = None,
        others: Mapping[str, Any] | None = None,
    ) -> None:
        settings = checked_settings(settings)
        if settings.motion == "objects":
            raise InputError(
                'motion is "objects", but chunks do not share the ids of moving objects: '
                "reconstruct in one process"
            )
        check_chunk(chunk)
        if mask is not None and not is_path(mask):
            raise InputTypeError(
                f"mask is {type(mask).__name__}: expected a path, which other processes can read"
            )
        source = _absolute_source(source)
        sources = FrameSource(
            source, step=step, start=start, stop=stop, size=size, crop=crop, mask=mask,
            bad_frames=bad_frames,
        )  # fmt: skip
        _refuse_float_frames(sources)
        given = None if poses is None else checked_poses(poses)
        if given is not None and bad_frames == "skip":
            raise InputError(
                'poses are given and bad_frames="skip": poses would not fit the remaining frames'
            )
        calibrate = checked_calibrate(calibrate, is_known=camera is not None or given is not None)
        camera, self._known_camera = checked_camera(camera)
        self.folder = Path(folder).absolute()
        files = [camera_file_path(camera)] if isinstance(camera, Path) else []
        refuse_inputs_inside([*sources.files, *files], self.folder)
        self._frames, times = _selected_frames(sources)
        self._notes = [*sources.notes, *filter(None, [times_note(times)])]
        self._missing: dict[int, Status] = {}
        frame_poses = None
        if given is not None:
            frame_poses, self._missing = poses_of_frames(given, times)
        self.request = make_request(
            sources,
            camera=camera,
            settings=settings,
            poses=given,
            arch=arch,
            files={"mask": None if mask is None else os.fspath(mask)},
            others={
                "calibrate": calibrate, "depth_of": depth_of, "size": size, "crop": crop,
                "bad_frames": bad_frames, "chunk": chunk, **(others or {}),
            },
        )  # fmt: skip
        self._chunks = [
            Chunk(
                folder=self.folder / CHUNKS / f"{number:03d}",
                source=source,
                span=span,
                frames={
                    "step": step, "size": size, "crop": crop, "bad_frames": bad_frames,
                    "mask": None if mask is None else os.path.abspath(mask),
                },
                camera=camera.absolute() if isinstance(camera, Path) else camera,
                calibrate=calibrate,
                settings=settings,
                poses=None if frame_poses is None else frame_poses[span.of(self._frames)],
                depth_of=depth_of,
                request_digest=request_digest(self.request),
                listing=sources.listing,
                stop=stop,
                arch=arch,
                threads=threads,
            )
            for number, span in enumerate(spans_of(self._frames, stop, chunk))
        ]  # fmt: skip

    def is_done(self) -> bool:
        """Return whether the folder holds the complete result.

        Raises ValueError if the folder holds a result, or chunks, of another request.
        """
        chunks = read_request(self.folder / CHUNKS)
        if chunks is None:
            return is_done(self.folder, self.request)
        refuse_differing_request(self.folder, chunks["asked"], self.request)
        whole = read_request(self.folder)
        same = whole is not None and whole["asked"] == self.request
        return same and is_done(self.folder, self.request)

    def result(
        self,
        # ``map_unordered(function, items)`` calls a function, which can be pickled, with each item,
        # in any process. It yields (number of the item, result) in the order in which items finish.
        map_unordered: UnorderedMap,
        *,
        resume: bool = False,  # keep the complete chunks that lie in the folder
        progress: Progress | None = None,  # as for `tisfm.reconstruct`
    ) -> Reconstruction:
        """Reconstruct the chunks and join them; chunks stay until `finish`.

        Raises Exception: as `tisfm.reconstruct`; ValueError if chunks in the folder are of another
        request.
        """
        warn_notes(self._notes)
        tell: Progress = progress or (lambda stage, done, total: None)
        path = make_result_folder(self.folder)
        with locked_folder(path), ExitStack() as stack:
            refuse_others(path)
            self._begin(path / CHUNKS, resume)
            alive = stack.enter_context(presence_file(path / CHUNKS))
            chunks, count = [replace(one, alive=alive) for one in self._chunks], len(self._frames)
            tell("path", 0, count)
            calibrated = None  # the result that the camera is from
            if len(chunks) > 1 and needs_calibration(chunks[0], self._known_camera):
                shared = shared_camera(chunks, map_unordered, path / CHUNKS)
                calibrated = shared.result
                chunks = [one.with_camera(shared.camera) for one in chunks]
            elif (
                len(chunks) > 1 and self._known_camera is None
            ):  # guessed from the first chunk alone
                list(complete_chunks(chunks[:1], map_unordered))
                guessed = camera_file_path(chunks[0].folder)
                chunks = [chunks[0], *(one.with_camera(guessed) for one in chunks[1:])]
            done = 0
            for number in complete_chunks(chunks, map_unordered):
                done += chunks[number].span.count
                tell("depth", min(done, count), count)
            parts = [
                ChunkResult.of(Reconstruction.load(one.folder), one.span, self._frames)
                for one in chunks
            ]
            places = place_chunks(parts, are_given=chunks[0].poses is not None)
            with renewed_locked_folder(path):
                return write_whole(
                    path,
                    parts,
                    places,
                    camera=calibrated or parts[0].result,
                    missing=self._missing,
                    notes=self._notes,
                )

    def finish(self) -> None:
        """Mark the result in the folder as complete, and remove the chunks."""
        with locked_folder(self.folder):
            write_request(self.folder, self.request)
            try_to_remove(self.folder / CHUNKS)

    def _begin(self, chunks: Path, resume: bool) -> None:
        remove_link(chunks)  # chunks would be written outside the folder
        before = read_request(chunks) if resume else None
        if before is not None:
            refuse_differing_request(self.folder, before["asked"], self.request)
            remove_temporaries(chunks)
            return
        remove(chunks)
        chunks.mkdir()
        write_request(chunks, self.request)


def reconstruct_in_chunks(
    # source, folder, options: as for `ChunkedRun`
    source: Source,
    folder: str | os.PathLike[str],
    *,
    # map_unordered, resume, progress: as for `ChunkedRun.result`
    map_unordered: UnorderedMap,
    resume: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> Reconstruction:
    """Reconstruct a sequence in chunks of frames, and return the joined result."""
    run = ChunkedRun(source, folder, **options)
    if resume and run.is_done():
        run.finish()
        return Reconstruction.load(run.folder)
    result = run.result(map_unordered, resume=resume, progress=progress)
    run.finish()
    if not result.calibration.seen:
        warnings.warn(result.calibration.message, GuessedFocalWarning, stacklevel=2)
    return result


def _absolute_source(source: Source) -> str | list[str]:
    """Return a source of files with absolute paths, which other processes can open."""
    if isinstance(source, (str, os.PathLike)):
        name = os.fspath(source)
        if webcam_number(name) is not None and not os.path.exists(name):
            raise InputError(
                f"source is {name}, a camera, and chunks need files: record it to a file first"
            )
        if not os.path.exists(name):
            refuse_url(name)
        return os.path.abspath(name)
    if isinstance(source, Sequence) and source and all(map(is_path, source)):
        return [os.path.abspath(item) for item in source]
    raise InputTypeError(
        "source is not a path, and chunks need files: expected a video, a folder, a pattern or "
        "image files, which other processes can read"
    )


def _selected_frames(source: FrameSource) -> tuple[range, list[float | None]]:
    """Return the numbers of the selected frames, and their times; None for an unknown time.

    The number of frames of a video is known only after it is read.
    """
    if source.names is not None:
        selected = range(len(source.frame_files))[source.chosen]
        return selected, list(source.times or (None,) * len(selected))
    frames_read: list[tuple[int, float | None]] = []
    with closing(source.frames()) as frames:
        for frame in frames:
            frames_read.append((frame.index, frame.time))
    last = max(
        [index for index, _ in frames_read] + [index for index, _ in source.skipped], default=-1
    )
    if not frames_read:
        raise InputError(f"{source.title} has no frame that can be read: expected at least 2")
    return range(last + 1)[source.chosen], [time for _, time in frames_read]


def _refuse_float_frames(source: FrameSource) -> None:
    with closing(source.frames()) as frames:
        first = next(frames, None)
    if first is not None and first.image.dtype.kind == "f":
        raise InputError(
            f"frame {first.name} has decimals: the scale of such frames depends on all earlier "
            "frames, which a chunk does not see; reconstruct in one process"
        )
