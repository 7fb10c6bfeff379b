"""The report of a reconstruction: path, status of every frame, and pictures of some frames."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.grade import Grade, percent
from tisfm.reconstruction.result.calibration import describe_focal
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.report.drawings import MAX_PIECES, path_drawing
from tisfm.report.page import Picture, Report, Slide, check_report, write_report
from tisfm.report.pictures import (
    Pictures,
    choose_slides,
    depth_legend,
    deviation_legend,
    flow_legend,
)
from tisfm.report.tables import (
    count_grades,
    count_statuses,
    nearest_preset,
    setting_rows,
    shorten,
    status_spans,
)
from tisfm.results.frame import ResultFrame
from tisfm.results.sequence_frames import SequenceFrames
from tisfm.show import (
    depth_to_color,
    flow_to_color,
    inverse_depth_limit,
    label_overlay,
    uncertainty_to_color,
    usual_length,
)

_DEPTH, _MOTION = "Depth, near is bright", "Image motion to the next frame"
_DEVIATION = "Relative deviation of depth"
_MAX_PICTURES = 5  # pictures of a frame, labels included
_CONVERGED = "The frame has a pose, and depth if it was requested."
_MAX_TABLE_ROWS = 40  # set by hand


def write_reconstruction_report(
    result: Reconstruction,
    folder: Path,  # folder of the report
    *,
    source: str | None = None,  # name of the source, if known
) -> Path:
    """Write ``report.html`` of a reconstruction into a folder; return its path.

    Raises OSError, ValueError if a file cannot be read or written, or if the report would replace a
    file that tisfm did not write.
    """
    path = check_report(folder)
    write_report(path, _report(result, folder, source))
    return path


def _report(result: Reconstruction, folder: Path, source: str | None) -> Report:
    counts = count_statuses(result.status, result.names, converged=_CONVERGED)
    first_frames = [int(np.argmax(result.piece == piece)) for piece in _pieces(result)]
    first_with_status = [list(map(str, result.status)).index(status.code) for status in counts]
    numbers = choose_slides(len(result), [*first_with_status, *first_frames])
    slides, flow_limit = _slides(result, numbers)
    has_all_frames = len(slides) == len(result)
    pieces = _pieces(result)
    text = (
        "The path begins at the circle, in dark colours, and ends at the square, in light colours. "
        "Numbers are in the unit of the path"
        f"{', and each piece has its own unit' if len(pieces) > 1 else ''}."
    )
    if len(pieces) > MAX_PIECES:
        text += f" Shown are the {MAX_PIECES} largest of {len(pieces)} pieces."
    return Report(
        title=source or folder.resolve().name,
        kind="A sequence, reconstructed by tisfm reconstruct",
        summary=_summary(result, folder, source),
        statuses=counts,
        grades=count_grades(result.grade_summary),
        grade_spans=status_spans([str(grade) for grade in result.grades]),
        spans=status_spans([str(status) for status in result.status]),
        unit="frame",
        drawing=path_drawing(result.poses, np.where(result.has_position, result.piece, -1)),
        drawing_title="Path of the camera",
        drawing_text=text,
        slides=slides,
        slides_text="All frames." if has_all_frames else f"{len(slides)} of {len(result)} frames.",
        legends=[
            depth_legend(_DEPTH, "of a piece"),
            flow_legend(_MOTION, f"{_MOTION}, of the static scene", flow_limit),
            deviation_legend(_DEVIATION),
        ],
        tables=[
            (
                "Moving objects",
                ("Number", "Frames", "With a pose", "Note"),
                [
                    (
                        str(moving_object.id),
                        str(len(moving_object.frames)),
                        str(int(np.isfinite(moving_object.poses[:, 0, 0]).sum())),
                        shorten(moving_object.message or ""),
                    )
                    for moving_object in result.objects[:_MAX_TABLE_ROWS]
                ],
            ),
            (
                "Frames that could not be read",
                ("Frame of the source", "Why"),
                [(str(k), shorten(reason)) for k, reason in result.skipped[:_MAX_TABLE_ROWS]],
            ),
            ("How the source was read", ("Note",), [(note,) for note in result.notes]),
        ],
        preset=nearest_preset(result.settings),
        settings=setting_rows(result.settings),
    )


def _summary(result: Reconstruction, folder: Path, source: str | None) -> list[tuple[str, str]]:
    pose_count = int(result.has_position.sum())
    turning_count = int((result.piece >= 0).sum()) - pose_count
    sizes = np.bincount(result.piece[result.piece >= 0])
    calibration = result.calibration
    focal = describe_focal(
        calibration.focal or result.camera.focal, calibration.focal_std, calibration.shape
    )
    height, width = result.shape
    rows = [
        *([("Source", source)] if source else []),
        ("Folder", folder.resolve().name),
        ("Frames", f"{len(result)}, {width} × {height} px"),
        ("With a pose", f"{pose_count} of {len(result)}"),
        *([("With an orientation only", str(turning_count))] if turning_count else []),
        ("Pieces", f"{len(sizes)}" + (f" ({_sizes_text(sizes)} frames)" if len(sizes) > 1 else "")),
        ("Keyframes", str(len(result.keyframes))),
        ("Grade", result.grade_summary.text),
        *(
            [("Deviations of poses, median", poses)]
            if (poses := result.pose_deviation_text)
            else []
        ),
        ("Preset", nearest_preset(result.settings)),
        ("Motion", result.settings.motion),
        ("Focal length", f"{focal}, {calibration.origin}"),
        ("Version", result.version),
    ]
    if calibration.message and calibration.message != f"{focal}, estimated from the sequence":
        rows.append(("Note on the camera", shorten(calibration.message)))
    if result.focal_note:
        rows.append(("Note on the focal length", shorten(result.focal_note)))
    if calibration.readout:
        rows.append(("Rolling shutter", f"{calibration.readout:.2f} of the time to the next frame"))
    if result.skipped:
        rows.append(("Frames that could not be read", str(len(result.skipped))))
    return rows


def _sizes_text(sizes: NDArray[np.int64], max_count: int = 8) -> str:
    rest = len(sizes) - max_count
    return ", ".join(map(str, sizes[:max_count])) + (f" and {rest} more" if rest > 0 else "")


def _slides(result: Reconstruction, numbers: list[int]) -> tuple[list[Slide], float]:
    """Return slides of some frames, and the common range of image motion, px."""
    frames = SequenceFrames(result)
    limits: dict[int, list[float]] = {}
    speeds = []
    for number in numbers:  # a first pass for the ranges: one for all frames of a piece
        frame = frames.read(number)
        limits.setdefault(int(result.piece[number]), []).append(
            inverse_depth_limit(frame.inverse_depth)
        )
        flow = _flow(frame)
        if flow is not None:
            speeds.append(usual_length(flow))  # 98th percentile, px
    depth_limits = {piece: _median_positive(values) for piece, values in limits.items()}
    flow_limit = _median_positive(speeds)
    pictures = Pictures(_MAX_PICTURES * len(numbers))
    slides = []
    for number in numbers:
        limit = depth_limits[int(result.piece[number])]
        slides.append(_slide(result, frames.read(number), limit, flow_limit, pictures))
    return slides, flow_limit


def _slide(
    result: Reconstruction,
    frame: ResultFrame,
    depth_limit: float,
    flow_limit: float,
    pictures: Pictures,
) -> Slide:
    number, inverse_depth = frame.number, frame.inverse_depth
    depth = deviation = motion = None
    if (inverse_depth > 0).any() and frame.inverse_depth_std is not None:
        depth = pictures.url(depth_to_color(inverse_depth, limit=depth_limit))
        deviation = pictures.url(uncertainty_to_color(inverse_depth, frame.inverse_depth_std))
        flow = _flow(frame)
        if flow is not None:
            motion = pictures.url(flow_to_color(flow, limit=flow_limit, beyond="same"))
    slide_pictures = [
        Picture(title="Frame", url=pictures.url(frame.picture)),
        Picture(title=_DEPTH, url=depth),
        Picture(title=_MOTION, url=motion),
        Picture(title=_DEVIATION, url=deviation),
    ]
    is_masked = result.settings.motion == "camera"  # what moves has no depth of its own
    if (result.objects or is_masked) and frame.labels is not None and frame.labels.any():
        overlay = label_overlay(frame.picture, frame.labels)
        title = "Pixels that move and are masked" if is_masked else "Moving objects"
        slide_pictures.append(Picture(title=title, url=pictures.url(overlay)))
    piece, status = int(result.piece[number]), frame.status
    frame_note = f"piece {piece}" if piece >= 0 else "no pose"
    if piece >= 0 and not result.has_position[number]:
        frame_note += ", orientation only"
    if number in result.keyframes:
        frame_note += ", keyframe"
    error = float(result.depth_error[number])
    if result.grade(number).is_green or result.grade(number) == Grade.POOR:
        frame_note += f", depth is expected to be off by {percent(error)}"
    advice = "" if status == "converged" and not status.message else shorten(status.message)
    return Slide(
        name=result.names[number],
        number=number,
        status=str(status),
        grade=str(result.grade(number)),
        shape=result.shape,
        message=f"{frame_note}. {advice}".strip(),
        pictures=slide_pictures,
    )


def _flow(frame: ResultFrame) -> NDArray[np.float32] | None:
    """Return the static scene's image motion to the next frame, (H, W, 2) px; None if unknown."""
    if 0 not in frame.motions:
        return None
    flow = np.full((*frame.shape, 2), np.nan, np.float32)
    flow[frame.has_depth] = frame.flow_of_motion(frame.motions[0][1], frame.has_depth)
    return flow if np.isfinite(flow).any() else None


def _pieces(result: Reconstruction) -> list[int]:
    return sorted({int(piece) for piece in result.piece if piece >= 0})


def _median_positive(values: list[float]) -> float:
    positive_values = [value for value in values if value > 0]
    return float(np.median(positive_values)) if positive_values else 1.0
