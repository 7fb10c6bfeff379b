"""Reconstruction of a sequence in chunks: from the source to the result folder, new or resumed."""

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
from tisfm.reconstruction.chunks.chunk import DEFAULT_CHUNK, Chunk, check_chunk, chunk_spans
from tisfm.reconstruction.chunks.error_report import ErrorReport
from tisfm.reconstruction.chunks.joining import write_joined_result
from tisfm.reconstruction.chunks.placement import ChunkResult, place_chunks
from tisfm.reconstruction.chunks.shared_camera import (
    UnorderedMap,
    complete_chunks,
    needs_calibration,
    shared_camera,
)
from tisfm.reconstruction.entry import (
    as_trajectory,
    refuse_inputs_inside,
    resolve_calibrate,
    resolve_camera,
    resolve_settings,
)
from tisfm.reconstruction.path.given_poses import find_frame_poses
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.renewal import CHUNKS, refuse_other_files, renewed_locked_folder
from tisfm.reconstruction.result.request import (
    is_done,
    make_request,
    read_request,
    refuse_differing_request,
    request_digest,
    write_request,
)
from tisfm.reconstruction.stages.progress import DepthOf, Progress, ReportDepth
from tisfm.runtime import Arch
from tisfm.settings import FixedPixels, Settings
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
        The folder of the result. Until the result is complete, its subfolder ``.tisfm-chunks`` has
        the chunks.
    camera, calibrate, settings, poses, depth_of, fixed_pixels
        As for `tisfm.reconstruct`.
    step, start, stop, size, crop, bad_frames
        As for `tisfm.reconstruct`.
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
        All data that determine the result: the frames and all options.

    Raises
    ------
    OSError, TypeError, ValueError
        As `tisfm.reconstruct`; if the source is a webcam or arrays; or if chunks are too short.
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
        fixed_pixels: FixedPixels = "mask",
        step: int = 1,
        start: int = 0,
        stop: int | None = None,
        size: int | None = None,
        crop: tuple[int, int, int, int] | None = None,
        bad_frames: BadFrames = "raise",
        chunk: int = DEFAULT_CHUNK,
        arch: Arch | None = None,
        threads: int | None = None,
        others: Mapping[str, Any] | None = None,
    ) -> None:
        settings = resolve_settings(settings)
        check_chunk(chunk)
        if mask is not None and not is_path(mask):
            raise InputTypeError(
                f"mask is {type(mask).__name__}: expected a path, which other processes can read"
            )
        source = _absolute_source(source)
        frame_source = FrameSource(
            source, step=step, start=start, stop=stop, size=size, crop=crop, mask=mask,
            bad_frames=bad_frames,
        )  # fmt: skip
        _refuse_float_frames(frame_source)
        given_poses = None if poses is None else as_trajectory(poses)
        if given_poses is not None and bad_frames == "skip":
            raise InputError(
                'poses are given and bad_frames="skip": poses would not fit the remaining frames'
            )
        calibrate = resolve_calibrate(
            calibrate, is_known=camera is not None or given_poses is not None
        )
        camera, self._known_camera = resolve_camera(camera)
        self.folder = Path(folder).absolute()
        files = [camera_file_path(camera)] if isinstance(camera, Path) else []
        refuse_inputs_inside([*frame_source.files, *files], self.folder)
        self._frames, times = _selected_frames(frame_source)
        self._notes = [*frame_source.notes, *filter(None, [times_note(times)])]
        self._missing: dict[int, Status] = {}
        frame_poses = None
        if given_poses is not None:
            frame_poses, self._missing = find_frame_poses(given_poses, times)
        self.request = make_request(
            frame_source,
            camera=camera,
            settings=settings,
            poses=given_poses,
            arch=arch,
            files={"mask": None if mask is None else os.fspath(mask)},
            others={
                "calibrate": calibrate, "depth_of": depth_of, "fixed_pixels": fixed_pixels,
                "size": size, "crop": crop, "bad_frames": bad_frames, "chunk": chunk,
                **(others or {}),
            },
        )  # fmt: skip
        self._chunks = [
            Chunk(
                folder=self.folder / CHUNKS / f"{number:03d}",
                source=source,
                span=span,
                frame_arguments={
                    "step": step, "size": size, "crop": crop, "bad_frames": bad_frames,
                    "fixed_pixels": fixed_pixels,
                    "mask": None if mask is None else os.path.abspath(mask),
                },
                camera=camera.absolute() if isinstance(camera, Path) else camera,
                calibrate=calibrate,
                settings=settings,
                poses=None if frame_poses is None else frame_poses[span.slice_in(self._frames)],
                depth_of=depth_of,
                request_digest=request_digest(self.request),
                listing=frame_source.listing,
                stop=stop,
                arch=arch,
                threads=threads,
            )
            for number, span in enumerate(chunk_spans(self._frames, stop, chunk))
        ]  # fmt: skip

    def is_done(self) -> bool:
        """Return whether the folder contains the complete result.

        Raises ValueError if the folder contains a result, or chunks, of another request.
        """
        chunks = read_request(self.folder / CHUNKS)
        if chunks is None:
            return is_done(self.folder, self.request)
        refuse_differing_request(self.folder, chunks["asked"], self.request)
        whole = read_request(self.folder)
        is_same = whole is not None and whole["asked"] == self.request
        return is_same and is_done(self.folder, self.request)

    def result(
        self,
        # ``map_unordered(function, items)`` calls a function that can be pickled with each item, in
        # any process. It yields (number of the item, result) in the order in which items finish.
        map_unordered: UnorderedMap,
        *,
        resume: bool = False,  # whether to keep complete chunks in the folder
        # progress, report_depth: as for `tisfm.reconstruct`
        progress: Progress | None = None,
        report_depth: ReportDepth | None = None,
    ) -> Reconstruction:
        """Reconstruct the chunks and join them; chunks stay until `finish`.

        Raises Exception: as `tisfm.reconstruct`; ValueError if chunks in the folder are of another
        request.
        """
        warn_notes(self._notes)
        report: Progress = progress or (lambda stage, done, total: None)
        path = make_result_folder(self.folder)
        with locked_folder(path), ExitStack() as stack:
            refuse_other_files(path)
            self._prepare_folder(path / CHUNKS, resume)
            presence = stack.enter_context(presence_file(path / CHUNKS))
            chunks, count = (
                [replace(chunk, presence=presence) for chunk in self._chunks],
                len(self._frames),
            )
            report("path", 0, count)
            camera_result = None  # the result with the camera of all chunks
            if len(chunks) > 1 and needs_calibration(chunks[0], self._known_camera):
                shared = shared_camera(chunks, map_unordered, path / CHUNKS)
                camera_result = shared.result
                chunks = [chunk.with_camera(shared.camera) for chunk in chunks]
            elif len(chunks) > 1 and self._known_camera is None:
                # Only the first chunk guesses the camera.
                list(complete_chunks(chunks[:1], map_unordered))
                guessed_camera = camera_file_path(chunks[0].folder)
                chunks = [chunks[0], *(chunk.with_camera(guessed_camera) for chunk in chunks[1:])]
            done = 0
            errors = ErrorReport(chunks, self._frames)
            for number in complete_chunks(chunks, map_unordered):
                done += chunks[number].span.count
                if report_depth is not None:
                    errors.add(number, report_depth)
                report("depth", min(done, count), count)
            parts = [
                ChunkResult.from_result(Reconstruction.load(chunk.folder), chunk.span, self._frames)
                for chunk in chunks
            ]
            placements = place_chunks(parts, has_given_poses=chunks[0].poses is not None)
            with renewed_locked_folder(path):
                return write_joined_result(
                    path,
                    parts,
                    placements,
                    camera=camera_result or parts[0].result,
                    missing=self._missing,
                    notes=self._notes,
                )

    def finish(self) -> None:
        """Mark the result in the folder as complete, and remove the chunks."""
        with locked_folder(self.folder):
            write_request(self.folder, self.request)
            try_to_remove(self.folder / CHUNKS)

    def _prepare_folder(self, chunks: Path, resume: bool) -> None:
        remove_link(chunks)  # a link would lead outside of the folder
        earlier = read_request(chunks) if resume else None
        if earlier is not None:
            refuse_differing_request(self.folder, earlier["asked"], self.request)
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
    """Return a source of files with absolute paths, so that other processes can open it."""
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
        frame_range = range(len(source.frame_files))[source.selection]
        return frame_range, list(source.times or (None,) * len(frame_range))
    frames_read: list[tuple[int, float | None]] = []
    with closing(source.frames()) as frames:
        for frame in frames:
            frames_read.append((frame.index, frame.time))
    last = max(
        [index for index, _ in frames_read] + [index for index, _ in source.skipped], default=-1
    )
    if not frames_read:
        raise InputError(f"{source.title} has no frame that can be read: expected at least 2")
    return range(last + 1)[source.selection], [time for _, time in frames_read]


def _refuse_float_frames(source: FrameSource) -> None:
    with closing(source.frames()) as frames:
        first = next(frames, None)
    if first is not None and first.image.dtype.kind == "f":
        raise InputError(
            f"frame {first.name} has decimals: the scale of such frames depends on all earlier "
            "frames, which a chunk does not see; reconstruct in one process"
        )
