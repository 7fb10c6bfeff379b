"""What a wrong focal length does to depth, motion and flow: ``python -m bench.focal``.

Scenes are `tisfm.scenes.static_scene`, rendered with focal lengths that are known, and interpreted
with multiples of them.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

import tisfm
from bench.contest import machine
from bench.depth_scores import depth_of
from bench.focal_plot import draw
from bench.two_stage import two_stage
from tisfm import runtime
from tisfm.evaluation import LITTLE_PARALLAX
from tisfm.metrics import depth_errors, endpoint_error
from tisfm.poses import pose_errors
from tisfm.rigid import pose_matrix
from tisfm.scenes import SyntheticPair, static_scene
from tisfm.scenes.ready import STATIC_KINDS
from tisfm.settings import Motion, Preset, Settings

FOCALS = (320.0, 600.0, 1000.0)  # px, true
# 5/3 takes 600 px for 1000 px, 0.6 the other way round: the pair that the paper compares.
RATIOS = (0.5, 0.6, 0.75, 0.9, 1.0, 1.1, 4 / 3, 5 / 3, 2.0)
PAPER = ((600.0, 5 / 3), (1000.0, 0.6))  # true focal length, ratio
EXACT = 0.01  # px, threshold of the essential matrix of the true flow
HARDLY = 1.2  # times the error at the true focal length
COLUMNS = {
    "abs_rel": ("abs-rel", ".4f"),
    "offset": ("offset of 1/Z", "+.3f"),
    "direction": ("direction, °", ".2f"),
    "rotation": ("rotation, °", ".4f"),
    "flow": ("EPE, px", ".4f"),
    "exact_abs_rel": ("abs-rel from the true flow", ".4f"),
    "field_abs_rel": ("abs-rel of the field", ".4f"),
    "field_flow": ("EPE of the field, px", ".4f"),
}


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One scene, interpreted with one focal length.

    Attributes
    ----------
    kind : str
        Of the scene's motion.
    focal : float
        The true focal length, px.
    ratio : float
        What it was multiplied by.
    status : str
    abs_rel : float or None
        Of depth, scaled by the median; None where the status says that there is none.
    offset : float or None
        What is added to the inverse depth, as a share of the scene's median: see `offset_of`.
    direction, rotation : float or None
        Errors of the motion, degrees.
    flow : float
        End-point error, px.
    exact_abs_rel : float
        Of the depth that an essential matrix and triangulation give from the true flow.
    field_abs_rel, field_flow : float
        The same of the flow field, whose depth is that of eq. 24.
    """

    kind: str
    focal: float
    ratio: float
    status: str
    abs_rel: float | None
    offset: float | None
    direction: float | None
    rotation: float | None
    flow: float
    exact_abs_rel: float
    field_abs_rel: float
    field_flow: float


def measure(pair: SyntheticPair, kind: str, ratio: float, preset: Preset) -> Outcome:
    """Interpret a scene with a multiple of its focal length, as one motion and as a field."""
    camera = tisfm.Camera(focal=pair.camera.focal * ratio, center=pair.camera.center)

    def interpreted(motion: Motion) -> tisfm.Interpretation:
        settings = Settings.preset(preset, motion=motion)
        return tisfm.interpret(pair.frame0, pair.frame1, camera=camera, settings=settings)

    found, field = interpreted("camera"), interpreted("field")
    seen = found.status not in LITTLE_PARALLAX and found.motions is not None
    exact = two_stage(pair.flow, camera, threshold=EXACT)
    errors = None
    if seen and found.motions is not None:
        errors = pose_errors(pose_matrix(found.motions[0]), pose_matrix(pair.motions[0]))
    return Outcome(
        kind=kind,
        focal=pair.camera.focal,
        ratio=ratio,
        status=str(found.status),
        abs_rel=depth_errors(found.depth, pair.depth).abs_rel if seen else None,
        offset=offset_of(found.inverse_depth, pair.inverse_depth) if seen else None,
        direction=errors.direction if errors else None,
        rotation=errors.rotation if errors else None,
        flow=endpoint_error(found.flow, pair.flow),
        exact_abs_rel=depth_errors(depth_of(exact.inverse_depth), pair.depth).abs_rel,
        field_abs_rel=depth_errors(field.depth, pair.depth).abs_rel,
        field_flow=endpoint_error(field.flow, pair.flow),
    )


def offset_of(inverse_depth: NDArray, truth: NDArray) -> float:
    """Return what has to be added to the true inverse depth so that the other is a multiple of it.

    Parameters
    ----------
    inverse_depth, truth : (H, W) array

    Returns
    -------
    float
        c of the best inverse_depth = a (truth + c), in medians of the truth.
    """
    slope, constant = np.polyfit(truth.ravel(), inverse_depth.ravel().astype(np.float64), 1)
    return float(constant / slope / np.median(truth))


def tables(outcomes: Sequence[Outcome]) -> str:
    """Return a Markdown table for every true focal length."""
    lines = []
    for focal in sorted({outcome.focal for outcome in outcomes}):
        lines += [f"## True focal length {focal:g} px", ""]
        titles = ["scene", "taken as, px", "ratio", *(title for title, _ in COLUMNS.values())]
        lines += ["| " + " | ".join(titles) + " |"]
        lines += ["| --- |" + " ---: |" * (len(titles) - 1)]
        for outcome in (o for o in outcomes if o.focal == focal):
            taken = f"{outcome.focal * outcome.ratio:.0f}"
            cells = [outcome.kind, taken, f"{outcome.ratio:.2f}"]
            for name, (_, form) in COLUMNS.items():
                value = getattr(outcome, name)
                cells.append(outcome.status if value is None else format(value, form))
            lines.append("| " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def finding(outcomes: Sequence[Outcome]) -> str:
    """Return in words what the paper's pair of focal lengths comes to, and what all ratios do."""
    at = {(o.kind, o.focal, round(o.ratio, 3)): o for o in outcomes}
    kinds = list(dict.fromkeys(o.kind for o in outcomes))
    sentences = []
    for focal, ratio in PAPER:
        compared = [
            (at[kind, focal, 1.0], at[kind, focal, round(ratio, 3)])
            for kind in kinds
            if (kind, focal, 1.0) in at and (kind, focal, round(ratio, 3)) in at
        ]
        if compared:
            sentences.append(f"f = {focal:g} px taken as {focal * ratio:.0f} px: ")
            sentences[-1] += _changes(compared) + "."
    turned = [o for o in outcomes if "rotation" in o.kind and o.offset is not None]
    if turned:
        low, high = (pick(turned, key=lambda o: o.offset or 0.0) for pick in (min, max))
        sentences.append(
            "What a rotation leaves unexplained at a wrong focal length is taken for parallax, "
            "much as a constant added to 1/Z: between "
            + " and ".join(
                f"{o.offset:+.2f} of its median ({o.kind}, {o.focal:g} px taken as "
                f"{o.focal * o.ratio:.0f} px)"
                for o in (low, high)
            )
            + ". Where that brings 1/Z to 0 or below, depth is lost, and the direction found may "
            "be the opposite."
        )
    rises = [o.field_flow / at[o.kind, o.focal, 1.0].field_flow for o in outcomes]
    sentences.append(
        f"The flow of the field changes its error by factors of {min(rises):.2f} to "
        f"{max(rises):.2f} over all ratios."
    )
    return " ".join(sentences)


def _changes(compared: Sequence[tuple[Outcome, Outcome]]) -> str:
    """Return what becomes of abs-rel and direction from the one focal length to the other."""
    depths: list[str] = []
    directions: list[str] = []
    same: list[str] = []
    other: list[str] = []
    for right, wrong in compared:
        if right.abs_rel is None or wrong.abs_rel is None:
            depths.append(f"{right.kind} {wrong.status}")
            continue
        depths.append(f"{right.kind} {right.abs_rel:.4f} → {wrong.abs_rel:.4f}")
        if right.direction is not None and wrong.direction is not None:
            directions.append(f"{right.direction:.2f}° → {wrong.direction:.2f}°")
        (same if wrong.abs_rel <= HARDLY * right.abs_rel else other).append(right.kind)
    text = f"abs-rel is {', '.join(depths)}; direction {', '.join(directions)}"
    text += f". So for depth it hardly matters (at most {HARDLY - 1:.0%} worse) in: "
    text += f"{', '.join(same) or 'none'}; it does in: {', '.join(other) or 'none'}"
    return text


def main(arguments: list[str] | None = None) -> int:
    """Measure, print and write the tables and the picture."""
    parser = argparse.ArgumentParser(prog="python -m bench.focal", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--height", type=int, default=240)
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--preset", choices=get_args(Preset), default="balanced")
    parser.add_argument("--threads", type=int, default=2, metavar="N")
    options = parser.parse_args(arguments)
    if options.threads < 1:
        parser.error(f"--threads is {options.threads}: expected at least 1")
    runtime.start(threads=options.threads)
    size = (options.height, options.width)
    outcomes = []
    for focal in FOCALS:
        for kind in STATIC_KINDS:
            pair = static_scene(kind, *size, focal=focal)
            outcomes += [measure(pair, kind, ratio, options.preset) for ratio in RATIOS]
    conditions = {
        "command": f"`python -m bench.focal --preset {options.preset}`",
        "scenes": f"`tisfm.scenes.static_scene`, {options.height}×{options.width}",
        "preset": options.preset,
        "threads": options.threads,
        **machine(),
    }
    text = finding(outcomes) + "\n\n" + tables(outcomes)
    print(text)
    heading = "# A wrong focal length\n\n"
    heading += "".join(f"- {name}: {value}\n" for name, value in conditions.items())
    notes = (
        "\nabs-rel is the mean of |ΔZ|/Z after scaling by the median; direction and rotation are "
        'errors of the camera\'s motion, `motion="camera"`; the field is `motion="field"`, whose '
        "depth is by eq. 24. Offset: c of the best 1/Z′ = a (1/Z + c), in medians of 1/Z. From the "
        "true flow: what an essential matrix and triangulation make of it with the same focal "
        "length, so that what remains is geometry. A scene is one pair of frames.\n\n"
        "![Errors over the ratio of the focal length taken to the true one](focal.png)\n\n"
    )
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "focal.md").write_text(heading + notes + text, encoding="utf-8")
    record = {**conditions, "found": [asdict(outcome) for outcome in outcomes]}
    (options.output / "focal.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    draw([asdict(outcome) for outcome in outcomes], options.output / "focal.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
