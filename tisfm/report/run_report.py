"""The report of a run: the status and numbers of every pair, and pictures of some pairs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tisfm.errors import InputError
from tisfm.focal_guess import at_size
from tisfm.grade import Grade, GradeSummary, summarise_grades
from tisfm.interpretation import Interpretation
from tisfm.report.drawings import curves_drawing
from tisfm.report.page import Picture, Report, Slide, check_report, write_report
from tisfm.report.pictures import (
    Pictures,
    choose_slides,
    confidence_legend,
    depth_legend,
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
from tisfm.results.frame import mean_inverse_depth
from tisfm.settings import Settings
from tisfm.show import (
    confidence_to_color,
    depth_to_color,
    flow_to_color,
    inverse_depth_limit,
    label_overlay,
    usual_length,
)
from tisfm.status import Status

_DEPTH, _MOTION, _CONFIDENCE = "Depth, near is bright", "Image motion", "Confidence"
_MAX_PICTURES = 4  # pictures of a pair, without labels


def write_run_report(
    folder: Path,  # folder of `tisfm run`; pairs with an ``.npz`` file get pictures
    record: Mapping[str, Any],  # contents of ``run.json`` in the folder
    *,
    source: str | None = None,  # name of the source, if known
) -> Path:
    """Write ``report.html`` of a run into its folder; return its path.

    Raises OSError, ValueError if a file cannot be read or written, or if the record is not the
    record of a run.
    """
    path = check_report(folder)
    run = _read(folder, record)
    write_report(path, _report(folder, run, source))
    return path


@dataclass(frozen=True, kw_only=True)
class _Pair:
    """The record of a pair; a missing number is None."""

    name: str
    number: int
    status: Status
    grade: Grade
    depth_error: float | None
    speed: float | None
    confidence: float | None
    occluded: float | None


@dataclass(frozen=True, kw_only=True)
class _Run:
    """The contents of a record; `focal`, px, belongs to frames of `focal_shape`, (H, W)."""

    pairs: Sequence[_Pair]
    settings: Settings
    focal: float
    focal_shape: tuple[int, int] | None
    start: int
    step: int
    arch: str
    version: str
    flow_limit: float | None
    notes: Sequence[str]


def _read(folder: Path, record: Mapping[str, Any]) -> _Run:
    """Read a record; raise ValueError if it is not the record of a run."""
    try:
        pairs = [
            _Pair(
                name=str(name),
                number=int(pair["number"]),
                status=Status(pair["status"], pair["message"]),
                grade=Grade(pair["grade"]),
                depth_error=_float_or_none(pair["depth_error"]),
                speed=_float_or_none(pair.get("speed")),
                confidence=_float_or_none(pair.get("confidence")),
                occluded=_float_or_none(pair.get("occluded")),
            )
            for name, pair in record["pairs"].items()
        ]
        source = record["source"]  # frames of the source, before cropping and shrinking
        return _Run(
            pairs=pairs,
            settings=Settings(**_as_tuples(record["settings"])),
            focal=float((record["camera"] if source is None else source)["focal"]),
            focal_shape=None if source is None else (int(source["height"]), int(source["width"])),
            start=int(record["start"]),
            step=int(record["step"]),
            arch=str(record["arch"]),
            version=str(record["version"]),
            flow_limit=_float_or_none(record.get("flow_limit")),
            notes=[str(note) for note in record["notes"]],
        )
    except (LookupError, TypeError, AttributeError, ValueError) as error:
        raise InputError(f"{folder} has no record of a run for a report ({error})") from error


def _report(folder: Path, run: _Run, source: str | None) -> Report:
    names = [pair.name for pair in run.pairs]
    statuses = [pair.status for pair in run.pairs]
    counts = count_statuses(statuses, names)
    codes = [str(status) for status in statuses]
    numbers = choose_slides(len(names), [codes.index(status.code) for status in counts])
    slide_pairs = [run.pairs[k] for k in numbers if (folder / f"{names[k]}.npz").is_file()]
    slides, shape, flow_limit = _slides(folder, slide_pairs, run.flow_limit)
    if not names:
        slides_text = "There is no pair."
    elif not slides:
        slides_text = "Pictures need NAME.npz, which this run did not write."
    else:
        slides_text = (
            f"{len(slides)} of {len(names)} pairs" if len(slides) < len(names) else "All pairs"
        )
        slides_text += ", each with its first frame."
    legends = [
        depth_legend(_DEPTH, "in multiples of each pair's mean inverse depth"),
        flow_legend(_MOTION, _MOTION, flow_limit),
        confidence_legend(_CONFIDENCE),
    ]
    return Report(
        title=source or folder.resolve().name,
        kind="Pairs of frames, interpreted by tisfm run",
        summary=_summary(folder, run, shape, source),
        statuses=counts,
        grades=count_grades(_summarise_grades(run.pairs)) if run.pairs else (),
        grade_spans=status_spans([str(pair.grade) for pair in run.pairs]),
        spans=status_spans(codes),
        unit="pair",
        drawing=curves_drawing(
            [
                ("motion, px", [pair.speed for pair in run.pairs]),
                ("confidence", [pair.confidence for pair in run.pairs]),
                ("occluded", [pair.occluded for pair in run.pairs]),
            ]
        ),
        drawing_title="Over the pairs",
        drawing_text="Mean length of the image motion, mean confidence, and share of the pixels "
        "that are not visible in the next frame.",
        slides=slides,
        slides_text=slides_text,
        legends=legends if slides else (),
        tables=[("How the source was read", ("Note",), [(note,) for note in run.notes])],
        preset=nearest_preset(run.settings),
        settings=setting_rows(run.settings),
    )


def _summary(
    folder: Path, run: _Run, shape: tuple[int, int] | None, source: str | None
) -> list[tuple[str, str]]:
    converged_count = sum(pair.status == "converged" for pair in run.pairs)
    count = len(run.pairs)
    return [
        *([("Source", source)] if source else []),
        ("Folder", folder.resolve().name),
        ("Pairs", str(count)),
        ("Converged", f"{converged_count} of {count}"),
        *([("Grade", _summarise_grades(run.pairs).text)] if run.pairs else []),
        *([("Frames", f"{shape[1]} × {shape[0]} px")] if shape else []),
        ("Preset", nearest_preset(run.settings)),
        ("Motion", run.settings.motion),
        ("Focal length", f"{run.focal:.5g} px{at_size(run.focal_shape or shape)}"),
        ("First frame, step", f"{run.start}, {run.step}"),
        ("Kernels ran on", run.arch),
        ("Version", run.version),
    ]


def _summarise_grades(pairs: Sequence[_Pair]) -> GradeSummary:
    errors = [np.nan if pair.depth_error is None else pair.depth_error for pair in pairs]
    return summarise_grades([pair.grade for pair in pairs], [pair.status for pair in pairs], errors)


def _slides(
    folder: Path, pairs: Sequence[_Pair], recorded_limit: float | None
) -> tuple[list[Slide], tuple[int, int] | None, float]:
    """Return slides of some pairs, the shape of the frames, and the range of image motion, px."""
    depth_limits, speeds, shape = [], [], None
    for pair in pairs:  # a first pass for the ranges, common to all pairs
        result = Interpretation.load(folder / f"{pair.name}.npz")
        shape = result.flow.shape[:2]
        mean_inverse = mean_inverse_depth(result.inverse_depth)
        if mean_inverse > 0 and str(result.status) not in ("diverged", "pose_mismatch"):
            depth_limits.append(inverse_depth_limit(result.inverse_depth) / mean_inverse)
        speeds.append(usual_length(result.flow))
    depth_limit = float(np.median(depth_limits)) if depth_limits else 1.0
    flow_limit = float(recorded_limit or (np.median(speeds) if speeds else 0.0))
    pictures = Pictures((_MAX_PICTURES + 1) * len(pairs))
    slides = []
    for pair in pairs:
        result = Interpretation.load(folder / f"{pair.name}.npz")
        mean_inverse = mean_inverse_depth(result.inverse_depth)
        images = [
            Picture(title="Frame", url=pictures.url(result.frame)),
            Picture(
                title=_DEPTH,
                url=pictures.url(
                    depth_to_color(result.inverse_depth, limit=depth_limit * mean_inverse)
                )
                if mean_inverse > 0
                else None,
            ),
            Picture(
                title=_MOTION,
                url=pictures.url(flow_to_color(result.flow, limit=flow_limit, beyond="same")),
            ),
            Picture(title=_CONFIDENCE, url=pictures.url(confidence_to_color(result.confidence))),
        ]
        if result.labels is not None and result.labels.max() > 0:
            overlay = label_overlay(result.frame, result.labels)
            images.append(Picture(title="Moving objects", url=pictures.url(overlay)))
        slides.append(
            Slide(
                name=pair.name,
                number=pair.number,
                status=str(pair.status),
                grade=str(pair.grade),
                shape=result.flow.shape[:2],
                message="" if pair.status == "converged" else shorten(pair.status.message),
                pictures=images,
            )
        )
    return slides, shape, flow_limit


def _as_tuples(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings with tuples in place of the lists of JSON."""
    return {k: tuple(v) if isinstance(v, list) else v for k, v in settings.items()}


def _float_or_none(value: Any) -> float | None:
    return None if value is None else float(value)
