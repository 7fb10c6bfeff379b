"""The report of a run: what its record says of every pair, and pictures of some."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tisfm.interpretation import Interpretation
from tisfm.outcome import Status
from tisfm.report.drawings import curves_drawing
from tisfm.report.file import refuse_foreign, write_page
from tisfm.report.page import Page, Slide, View, html
from tisfm.report.pictures import Pictures, chosen
from tisfm.report.settings_table import nearest_preset, setting_rows
from tisfm.report.shared import depth_legend, duration, flow_legend, share_legend
from tisfm.report.statuses import counted, shortened, spans
from tisfm.settings import Settings
from tisfm.show import (
    confidence_to_color,
    depth_to_color,
    flow_to_color,
    inverse_depth_limit,
    label_overlay,
    usual_length,
)

_VIEWS = 4  # pictures of a pair; one more for labels


def write_run_report(
    folder: Path,
    record: Mapping[str, Any],
    *,
    seconds: Sequence[float] = (),
    source: str | None = None,
) -> Path:
    """Write ``report.html`` of a run into its folder; return its path.

    Parameters
    ----------
    folder : Path
        What `tisfm run` wrote. Pictures are of the pairs whose ``.npz`` is there.
    record : mapping
        What its ``run.json`` says.
    seconds : sequence of float
        How long pairs were interpreted, as far as that is known.
    source : str, optional
        What it was a run of, if that is known.

    Raises
    ------
    OSError, ValueError
        If a file cannot be read or written, or the record is not that of a run.
    """
    path = refuse_foreign(folder)
    try:
        page = _page(folder, record, seconds, source)
    except (LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"{folder} holds no run that a report can be made of ({error})") from error
    write_page(path, html(page))
    return path


def _page(
    folder: Path, record: Mapping[str, Any], seconds: Sequence[float], source: str | None
) -> Page:
    names = list(record["pairs"])
    pairs = list(record["pairs"].values())
    statuses = [Status(pair["status"], pair["message"]) for pair in pairs]
    settings = Settings(**_as_tuples(record["settings"]))
    counts = counted(statuses, names)
    codes = [str(status) for status in statuses]
    numbers = chosen(len(names), [codes.index(status.code) for status in counts])
    shown = [k for k in numbers if (folder / f"{names[k]}.npz").is_file()]
    slides, shape, flow_limit = _slides(folder, names, pairs, statuses, shown, record)
    known = [float(value) for value in seconds]
    timings = []
    if known:
        timings = [
            ("Interpreting, the last command", duration(sum(known))),
            ("A pair, median", duration(float(np.median(known)))),
            ("The slowest pair", duration(max(known))),
        ]
    if not names:
        told = "There is no pair."
    elif not slides:
        told = "Pictures are made of NAME.npz, which this run did not write."
    else:
        told = f"{len(slides)} of {len(names)} pairs" if len(slides) < len(names) else "All pairs"
        told += ", each by its first frame."
    legends = [
        ("Depth", depth_legend("in multiples of each pair's mean inverse depth")),
        ("Image motion", flow_legend(flow_limit)),
        ("Confidence", share_legend()),
    ]
    return Page(
        title=source or folder.resolve().name,
        kind="Pairs of frames, interpreted by tisfm run",
        summary=_summary(folder, record, settings, shape, source),
        statuses=counts,
        spans=spans(codes),
        unit="pair",
        drawing=curves_drawing(
            [
                ("motion, px", [pair.get("speed") for pair in pairs]),
                ("confidence", [pair.get("confidence") for pair in pairs]),
                ("occluded", [pair.get("occluded") for pair in pairs]),
            ]
        ),
        drawing_title="Over the pairs",
        drawing_text="Mean length of the image motion, mean confidence, and the share of the "
        "pixels that the next frame does not show.",
        slides=slides,
        slides_text=told,
        legends=legends if slides else (),
        preset=nearest_preset(settings),
        settings=setting_rows(settings),
        timings=timings,
    )


def _summary(
    folder: Path,
    record: Mapping[str, Any],
    settings: Settings,
    shape: tuple[int, int] | None,
    source: str | None,
) -> list[tuple[str, str]]:
    camera = record["camera"]
    converged = sum(pair["status"] == "converged" for pair in record["pairs"].values())
    count = len(record["pairs"])
    return [
        *([("Source", source)] if source else []),
        ("Folder", folder.resolve().name),
        ("Pairs", str(count)),
        ("Converged", f"{converged} of {count}"),
        *([("Frames", f"{shape[1]} × {shape[0]} px")] if shape else []),
        ("Preset", nearest_preset(settings)),
        ("Motion", settings.motion),
        ("Focal length", f"{camera['focal']:.5g} px"),
        ("First frame, step", f"{record['start']}, {record['step']}"),
        ("Kernels ran on", str(record["arch"])),
        ("Version", str(record["version"])),
    ]


def _slides(
    folder: Path,
    names: Sequence[str],
    pairs: Sequence[Mapping[str, Any]],
    statuses: Sequence[Status],
    shown: Sequence[int],
    record: Mapping[str, Any],
) -> tuple[list[Slide], tuple[int, int] | None, float]:
    """Return slides of some pairs, the shape of the frames, and the range of image motion, px."""
    levels, speeds, shape = [], [], None
    for k in shown:  # ranges first, so that one holds for all of them
        result = Interpretation.load(folder / f"{names[k]}.npz")
        shape = result.flow.shape[:2]
        level = _mean_inverse_depth(result)
        if level > 0 and str(result.status) not in ("diverged", "pose_mismatch"):
            levels.append(inverse_depth_limit(result.inverse_depth) / level)
        speeds.append(usual_length(result.flow))
    depth_limit = float(np.median(levels)) if levels else 1.0
    flow_limit = float(record.get("flow_limit") or (np.median(speeds) if speeds else 0.0))
    pictures = Pictures((_VIEWS + 1) * len(shown))
    slides = []
    for k in shown:
        result = Interpretation.load(folder / f"{names[k]}.npz")
        level = _mean_inverse_depth(result)
        views = [
            View(title="Frame", url=pictures.url(result.frame)),
            View(
                title="Depth, near is bright",
                url=pictures.url(depth_to_color(result.inverse_depth, limit=depth_limit * level))
                if level > 0
                else None,
            ),
            View(
                title="Image motion",
                url=pictures.url(flow_to_color(result.flow, limit=flow_limit, beyond="same")),
            ),
            View(title="Confidence", url=pictures.url(confidence_to_color(result.confidence))),
        ]
        if result.labels is not None and result.labels.max() > 0:
            overlay = label_overlay(result.frame, result.labels)
            views.append(View(title="What moves on its own", url=pictures.url(overlay)))
        message = "" if statuses[k] == "converged" else shortened(statuses[k].message)
        slides.append(
            Slide(
                name=names[k],
                number=int(pairs[k]["number"]),
                status=str(statuses[k]),
                message=message,
                views=views,
            )
        )
    return slides, shape, flow_limit


def _mean_inverse_depth(result: Interpretation) -> float:
    """Return the unit of a pair's inverse depth, which takes its own scale out."""
    mean = float(np.maximum(np.nan_to_num(result.inverse_depth), 0).mean(dtype=np.float64))
    return mean if np.isfinite(mean) else 0.0


def _as_tuples(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings as they were before JSON made lists of them."""
    return {k: tuple(v) if isinstance(v, list) else v for k, v in settings.items()}
