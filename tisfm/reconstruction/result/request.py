"""The request of a reconstruction; `--resume` compares it with the request of a stored result."""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.camera_file import read_camera_record
from tisfm.errors import InputError
from tisfm.folders.files import (
    REPORT,
    TIMINGS,
    compare_records,
    file_checksum,
    files_digest,
    summarise_differences,
)
from tisfm.folders.result_folder import LOCK
from tisfm.formats import FormatError, atomic_write
from tisfm.formats.reading import read_json
from tisfm.reconstruction.result.folder import MARKER, RECORD, REQUEST
from tisfm.settings import Settings
from tisfm.sources import FrameSource
from tisfm.sources.paths import files_of_pattern
from tisfm.trajectory import Trajectory
from tisfm.version import __version__

Request = dict[str, Any]


def make_request(
    frames: FrameSource,  # a source of files
    *,
    # camera, settings, poses: as for `tisfm.reconstruct`
    camera: Camera | Path | None,
    settings: Settings,
    poses: Trajectory | None,
    arch: str | None,  # the processor that kernels run on
    others: Mapping[str, Any],  # further options, as JSON values
    # options that name files, a folder or a pattern; the request contains digests of these files
    files: Mapping[str, str | None] | None = None,
) -> Request:
    """Return all data that determine a result, as JSON values."""
    frame_files = frames.frame_files
    camera_record = camera and (
        read_camera_record(camera) if isinstance(camera, Path) else asdict(camera)
    )
    request = {
        "version": __version__,
        "arch": arch or os.environ.get("TI_ARCH", "cpu"),
        "lanes": runtime.cpu_lanes(),
        "frames": files_digest(
            frame_files if frames.names is None else frame_files[frames.selection]
        ),
        "start": frames.selection.start,
        "stop": frames.selection.stop,
        "step": frames.selection.step,
        "camera": camera_record,
        "settings": asdict(settings),
        "poses": None if poses is None else _trajectory_digest(poses),
        **{name: path and files_digest(_files_of(path)) for name, path in (files or {}).items()},
        **others,
    }
    json_request: Request = json.loads(json.dumps(request))
    return json_request


def request_digest(request: Request) -> str:
    """Return a short digest of a request."""
    return hashlib.sha256(json.dumps(request, sort_keys=True).encode()).hexdigest()[:32]


def _trajectory_digest(poses: Trajectory) -> str:
    digest = hashlib.sha256(poses.poses.tobytes())
    digest.update(b"" if poses.times is None else poses.times.tobytes())
    return digest.hexdigest()[:32]


def _files_of(path: str) -> Sequence[Path]:
    """Return the files of a path: a file, a folder or a pattern."""
    if Path(path).is_dir():
        return [file for file in sorted(Path(path).rglob("*")) if file.is_file()]
    if Path(path).exists():
        return [Path(path)]
    return sorted(files_of_pattern(path))


def files_below(folder: Path) -> dict[str, list[int]]:
    """Return length and CRC-32 of the files in a folder, by their relative paths.

    Not contained are hidden files, a report (the user may make it later), timings (each run has
    others), the mark of an incomplete result, and the request.
    """
    checksums = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name.startswith(".") or name in (LOCK, REQUEST, MARKER, REPORT, TIMINGS):
            continue
        checksum = file_checksum(path)
        if checksum is not None:
            checksums[name] = list(checksum)
    return checksums


def write_request(folder: Path, request: Request) -> None:
    """Write the request and the checksums of the result's files, so that the result is complete."""
    record = {"asked": request, "files": files_below(folder)}
    with atomic_write(folder / REQUEST, durable=True) as file:
        file.write((json.dumps(record, indent=1) + "\n").encode())


def read_request(folder: Path) -> Request | None:
    """Return the content of the request file: ``asked`` and ``files``; None without such a file."""
    try:
        record = read_json(folder / REQUEST)
    except (FormatError, OSError):
        return None
    is_complete = isinstance(record, dict) and all(
        isinstance(record.get(name), dict) for name in ("asked", "files")
    )
    return record if is_complete else None


def is_done(folder: Path, request: Request) -> bool:
    """Return whether a folder has the complete result of a request.

    Raises ValueError if it has the result of another request; the message names the differences.
    """
    record = read_request(folder)
    if record is None or not (folder / RECORD).exists():
        return False
    refuse_differing_request(folder, record["asked"], request)
    return bool(record["files"] == files_below(folder))


def refuse_differing_request(folder: Path, earlier: Request, request: Request) -> None:
    """Raise InputError with the differences if a request differs from the earlier request."""
    differences = summarise_differences(compare_records(earlier, request))
    if differences:
        raise InputError(
            f"{folder} holds a reconstruction of other frames, with other options, or of another "
            f"version ({differences}): repeat its options, or run without --resume to start again"
        )
