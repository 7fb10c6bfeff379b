"""A file with the grades of exported frames, for formats that have no room for a text."""

import math
from collections.abc import Sequence
from pathlib import Path

from tisfm.formats import atomic_write
from tisfm.grade import Grade, GradeSummary, warn_of_grades
from tisfm.results.result_frames import ResultFrames

GRADES = "grade.txt"
_HEADING = "# grades of the exported frames, by tisfm export"


def write_grades(frames: ResultFrames, folder: Path, chosen: Sequence[int]) -> str:
    """Write ``grade.txt`` if frames are contradicted or poor; return a warning, or "".

    The file has the warning, the number of frames of each grade, and a line for each frame: number,
    grade, expected error of depth, name. If all frames are right, such a file of an earlier export
    is removed.

    Raises OSError if the file cannot be written.
    """
    path = folder / GRADES
    warning = warn_of_grades(frames.grades, frames.statuses, frames.depth_errors, chosen)
    if not warning:
        if path.is_file() and path.read_bytes().startswith(_HEADING.encode()):
            path.unlink()
        return ""
    counts = GradeSummary.of([frames.grades[k] for k in chosen]).counts_text
    lines = [_HEADING, f"# {' '.join(warning.split())}", f"# {counts}"]
    lines.append("# frame; grade; expected relative error of depth; name")
    for frame in chosen:
        error = frames.depth_errors[frame]
        is_known = not math.isnan(error) and frames.grades[frame] != Grade.CONTRADICTED
        error_text = f"{error:.4g}" if is_known else "unknown"
        lines.append(f"{frame}; {frames.grades[frame]}; {error_text}; {frames.names[frame]}")
    with atomic_write(path) as file:
        file.write("".join(f"{line}\n" for line in lines).encode("utf-8", "backslashreplace"))
    return warning
