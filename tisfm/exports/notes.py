"""What is to be said of an export: what it left out, and what it had to assume."""

import numpy as np

from tisfm.exports.camera_axes import is_centered
from tisfm.exports.clock import FRAME_RATE
from tisfm.exports.depths import LARGEST, VALUES_PER_UNIT, DepthKind, check_fits, frames_with_depth
from tisfm.exports.export_request import Export, source_camera
from tisfm.exports.pieces import pieces_of
from tisfm.exports.result_frames import PairFrames
from tisfm.focal_guess import at_size
from tisfm.trajectory.times import are_increasing


def of_poses(export: Export) -> list[str]:
    """Tell of frames without a pose, and of several pieces."""
    pieces = pieces_of(export.sequence, export.chosen)
    without = len(export.chosen) - sum(map(len, pieces))
    notes = [f"{_frames(without)} without a pose left out"] if without else []
    if len(pieces) > 1:
        sizes = ", ".join(str(len(piece)) for piece in pieces)
        notes.append(
            f"{len(pieces)} pieces ({sizes} frames), each in a scale of its own, a file for each"
        )
    return notes


def of_models(export: Export) -> list[str]:
    """Tell of frames that are in no model: without a pose, or in a piece of their own."""
    pieces = [piece for piece in pieces_of(export.sequence, export.chosen) if len(piece) > 1]
    notes = []
    if without := len(export.chosen) - sum(map(len, pieces)):
        notes.append(f"{_frames(without)} without a pose, or in a piece of one frame, left out")
    if len(pieces) > 1:
        sizes = ", ".join(str(len(piece)) for piece in pieces)
        notes.append(
            f"{len(pieces)} pieces ({sizes} frames), each in a scale and a model of its own"
        )
    return notes


def of_largest(export: Export) -> list[str]:
    """Tell of frames that are not in the largest piece."""
    largest = max(map(len, pieces_of(export.sequence, export.chosen)))
    without = len(export.chosen) - largest
    return [f"the largest piece; {_frames(without)} not in it left out"] if without else []


def of_times(export: Export) -> list[str]:
    """Tell where times are numbers of frames."""
    if are_increasing(export.frames.times) or export.frames_per_second is not None:
        return []
    return [f"{_without(export)}: their numbers stand for seconds; --fps says how many a second"]


def of_rate(export: Export) -> list[str]:
    """Tell where the frame rate is a guess."""
    known = are_increasing([export.frames.times[frame] for frame in export.chosen])
    if (known and len(export.chosen) > 1) or export.frames_per_second is not None:
        return []
    return [f"{_without(export)}: {FRAME_RATE:g} a second are assumed; --fps says how many"]


def of_lens(export: Export) -> list[str]:
    """Tell where the principal point is not in the middle, for which a format has no place."""
    result = export.sequence
    if is_centered(result.camera, result.shape):
        return []
    cx, cy = result.camera.center_for(*result.shape)
    size = at_size(result.shape)
    return [
        f"the principal point is at ({cx:.1f}, {cy:.1f}) px{size}, not in the middle, for which "
        "the file has no place: set the shift of the lens by lens.json"
    ]


def of_shutter(export: Export) -> list[str]:
    """Tell where frames differ from the source by more than the lens."""
    if not source_camera(export)[0].readout:
        return []
    return ["what a rolling shutter moved is not in the maps: frames of the result have it undone"]


def of_depth(export: Export) -> list[str]:
    """Tell of frames without depth, and of depth whose status this version does not know."""
    shown = frames_with_depth(export.frames, export.chosen)
    without = len(export.chosen) - len(shown)
    notes = [f"{_frames(without)} without depth left out"] if without else []
    codes = [code for frame in shown if (code := export.frames.unknown_status(frame))]
    if codes:
        notes.append(
            f"{_frames(len(codes))} with a status that this version does not know "
            f"({', '.join(sorted(set(codes)))}): treat their depth as doubtful"
        )
    return notes


def of_scale(export: Export, kind: DepthKind) -> list[str]:
    """Tell the scale of 16-bit depth, and what is beyond it."""
    scale = VALUES_PER_UNIT[kind]
    beyond = check_fits(export.frames, frames_with_depth(export.frames, export.chosen), kind)
    unit = "the unit of the path"
    if isinstance(export.frames, PairFrames):
        unit = "the unit of the poses" if export.frames.is_posed else "each pair's own unit"
    notes = [f"depth is value / {scale:g}, in {unit}"]
    if beyond:
        notes.append(
            f"about {np.ceil(1000 * beyond) / 10:g} % of it is beyond {LARGEST / scale:.4g}, and 0 "
            "in the files"
        )
    return notes


def _without(export: Export) -> str:
    """Return why the times of frames are not taken."""
    if any(export.frames.times[frame] is None for frame in export.chosen):
        return "frames have no times"
    return "frames have no times that rise"


def _frames(count: int) -> str:
    return f"{count} frame{'s' * (count != 1)}"
