"""The report of a reconstruction: its path, what became of every frame, and pictures of some."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.reconstruction.result.calibration import describe_focal
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.report.drawings import MOST_PIECES, path_drawing
from tisfm.report.embedded_images import Pictures, chosen
from tisfm.report.file import refuse_foreign, write_page
from tisfm.report.legends import depth_legend, deviation_legend, flow_legend
from tisfm.report.page import Page, Slide, View, html
from tisfm.report.setting_rows import nearest_preset, setting_rows
from tisfm.report.statuses import counted, shortened, spans
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
_VIEWS = 5  # pictures of a frame, with labels
_CONVERGED = "The frame has a pose, and depth if that was asked for."
_MOST_ROWS = 40  # of a table of things, or of frames that could not be read


def write_reconstruction_report(
    result: Reconstruction,
    folder: Path,
    *,
    source: str | None = None,
) -> Path:
    """Write ``report.html`` of a reconstruction into a folder; return its path.

    Parameters
    ----------
    result : Reconstruction
    folder : Path
        Where the report is to lie.
    source : str, optional
        What was reconstructed, if that is known.

    Raises
    ------
    OSError, ValueError
        If a file cannot be read or written, or something else is called like the report.
    """
    path = refuse_foreign(folder)
    write_page(path, html(_page(result, folder, source)))
    return path


def predicted_flow(
    inverse_depth: NDArray[np.float32],
    pose: NDArray[np.float64],
    next_pose: NDArray[np.float64],
    camera: Camera,
) -> NDArray[np.float32]:
    """Return the image motion that depth and path give what is at rest.

    Parameters
    ----------
    inverse_depth : (H, W) float32
        NaN where there is none.
    pose, next_pose : (4, 4) float64
        Of this frame and of the next, camera to world.
    camera : Camera
        The pinhole of the frames.

    Returns
    -------
    (H, W, 2) float32
        px; NaN where there is no depth, or what is seen would lie behind the next camera.
    """
    height, width = inverse_depth.shape
    cx, cy = camera.center or ((width - 1) / 2, (height - 1) / 2)
    y, x = np.mgrid[:height, :width].astype(np.float64)
    rays = np.stack([(x - cx) / camera.focal, (y - cy) / camera.focal, np.ones_like(x)], axis=-1)
    motion = np.linalg.inv(next_pose) @ pose
    moved = rays @ motion[:3, :3].T + inverse_depth[..., None] * motion[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = camera.focal * moved[..., :2] / moved[..., 2:]
    flow = np.stack([ends[..., 0] + cx - x, ends[..., 1] + cy - y], axis=-1)
    flow[~(np.isfinite(flow).all(axis=-1) & (moved[..., 2] > 0))] = np.nan
    return flow.astype(np.float32)


def _page(result: Reconstruction, folder: Path, source: str | None) -> Page:
    counts = counted(result.status, result.names, converged=_CONVERGED)
    begins = [int(np.argmax(result.piece == piece)) for piece in _pieces(result)]
    first = [list(map(str, result.status)).index(status.code) for status in counts]
    numbers = chosen(len(result), [*first, *begins])
    slides, flow_limit = _slides(result, numbers)
    whole = len(slides) == len(result)
    pieces = _pieces(result)
    drawn = (
        "The camera begins at the circle and ends at the square, early dark and late light. "
        "Numbers are in the unit of the path"
        f"{', and each piece has one of its own' if len(pieces) > 1 else ''}."
    )
    if len(pieces) > MOST_PIECES:
        drawn += f" Shown are the {MOST_PIECES} largest of {len(pieces)} pieces."
    return Page(
        title=source or folder.resolve().name,
        kind="A sequence, reconstructed by tisfm reconstruct",
        summary=_summary(result, folder, source),
        statuses=counts,
        spans=spans([str(status) for status in result.status]),
        unit="frame",
        drawing=path_drawing(result.poses, result.piece),
        drawing_title="Path of the camera",
        drawing_text=drawn,
        slides=slides,
        slides_text="All frames." if whole else f"{len(slides)} of {len(result)} frames.",
        legends=[
            (_DEPTH, "Depth", depth_legend("of a piece")),
            (_MOTION, f"{_MOTION}, of what is at rest", flow_legend(flow_limit)),
            (_DEVIATION, "Deviation of depth", deviation_legend()),
        ],
        tables=[
            (
                "Things that move on their own",
                ("Number", "Frames", "With a pose", "What is to be known"),
                [
                    (
                        str(thing.id),
                        str(len(thing.frames)),
                        str(int(np.isfinite(thing.poses[:, 0, 0]).sum())),
                        shortened(thing.message or ""),
                    )
                    for thing in result.objects[:_MOST_ROWS]
                ],
            ),
            (
                "Frames that could not be read",
                ("Frame of the source", "Why"),
                [(str(k), shortened(reason)) for k, reason in result.skipped[:_MOST_ROWS]],
            ),
            ("How the source was read", ("Note",), [(note,) for note in result.notes]),
        ],
        preset=nearest_preset(result.settings),
        settings=setting_rows(result.settings),
    )


def _summary(result: Reconstruction, folder: Path, source: str | None) -> list[tuple[str, str]]:
    placed = int((result.piece >= 0).sum())
    sizes = np.bincount(result.piece[result.piece >= 0])
    about = result.calibration
    focal = describe_focal(about.focal or result.camera.focal, about.focal_std, about.shape)
    height, width = result.shape
    rows = [
        *([("Source", source)] if source else []),
        ("Folder", folder.resolve().name),
        ("Frames", f"{len(result)}, {width} × {height} px"),
        ("With a pose", f"{placed} of {len(result)}"),
        ("Pieces", f"{len(sizes)}" + (f" ({_listed(sizes)} frames)" if len(sizes) > 1 else "")),
        ("Keyframes", str(len(result.keyframes))),
        ("Preset", nearest_preset(result.settings)),
        ("Motion", result.settings.motion),
        ("Focal length", f"{focal}, {about.origin}"),
        ("Version", result.version),
    ]
    if about.message and about.message != f"{focal}, found from the sequence":
        rows.append(("What is known of the camera", shortened(about.message)))
    if about.readout:
        rows.append(("Rolling shutter", f"{about.readout:.2f} of the time to the next frame"))
    if result.skipped:
        rows.append(("Frames that could not be read", str(len(result.skipped))))
    return rows


def _listed(sizes: NDArray[np.int64], most: int = 8) -> str:
    more = len(sizes) - most
    return ", ".join(map(str, sizes[:most])) + (f" and {more} more" if more > 0 else "")


def _slides(result: Reconstruction, numbers: list[int]) -> tuple[list[Slide], float]:
    """Return slides of some frames, and the range of image motion, px."""
    limits: dict[int, list[float]] = {}
    speeds = []
    for number in numbers:  # ranges first, so that one holds for all frames of a piece
        inverse_depth = result.inverse_depth(number)
        limits.setdefault(int(result.piece[number]), []).append(inverse_depth_limit(inverse_depth))
        flow = _flow(result, number, inverse_depth)
        if flow is not None:
            speeds.append(usual_length(flow))
    tops = {piece: _median_above_0(found) for piece, found in limits.items()}
    flow_limit = _median_above_0(speeds)
    pictures = Pictures(_VIEWS * len(numbers))
    slides = [_slide(result, number, tops, flow_limit, pictures) for number in numbers]
    return slides, flow_limit


def _slide(
    result: Reconstruction,
    number: int,
    tops: Mapping[int, float],
    flow_limit: float,
    pictures: Pictures,
) -> Slide:
    frame, inverse_depth = result.picture(number), result.inverse_depth(number)
    has_depth = bool((inverse_depth > 0).any())
    piece, status = int(result.piece[number]), result.status[number]
    depth = deviation = motion = None
    if has_depth:
        depth = pictures.url(depth_to_color(inverse_depth, limit=tops[piece]))
        std = result.inverse_depth_std(number)
        deviation = pictures.url(uncertainty_to_color(inverse_depth, std))
        flow = _flow(result, number, inverse_depth)
        if flow is not None:
            motion = pictures.url(flow_to_color(flow, limit=flow_limit, beyond="same"))
    views = [
        View(title="Frame", url=pictures.url(frame)),
        View(title=_DEPTH, url=depth),
        View(title=_MOTION, url=motion),
        View(title=_DEVIATION, url=deviation),
    ]
    labels = result.labels(number) if result.objects else None
    if labels is not None and labels.any():
        overlay = label_overlay(frame, labels)
        views.append(View(title="What moves on its own", url=pictures.url(overlay)))
    where = f"piece {piece}" if piece >= 0 else "no pose"
    if number in result.keyframes:
        where += ", keyframe"
    told = "" if status == "converged" and not status.message else shortened(status.message)
    return Slide(
        name=result.names[number],
        number=number,
        status=str(status),
        shape=result.shape,
        message=f"{where}. {told}".strip(),
        views=views,
    )


def _flow(
    result: Reconstruction, number: int, inverse_depth: NDArray[np.float32]
) -> NDArray[np.float32] | None:
    """Return the image motion to the next frame, None where poses or depth do not show it."""
    following = number + 1
    if following >= len(result) or result.piece[number] < 0:
        return None
    if result.piece[following] != result.piece[number]:
        return None
    flow = predicted_flow(
        inverse_depth, result.poses[number], result.poses[following], result.camera
    )
    return flow if np.isfinite(flow).any() else None


def _pieces(result: Reconstruction) -> list[int]:
    return sorted({int(piece) for piece in result.piece if piece >= 0})


def _median_above_0(values: list[float]) -> float:
    known = [value for value in values if value > 0]
    return float(np.median(known)) if known else 1.0
