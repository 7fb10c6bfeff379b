"""``python -m bench.focal``: effect of a wrong focal length on depth, motion and flow.

Scenes are `tisfm.scenes.static_scene`, rendered with a known focal length and interpreted with
multiples of it.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

import tisfm
from bench.depth.methods import two_stage
from bench.depth.scores import depth_of
from bench.shared.command import command_text, options_parser
from bench.shared.figures import CURVES, tidy
from bench.shared.results import RESULTS, Table, machine, markdown_page, write_results
from tisfm import runtime
from tisfm.evaluation.pair_errors import LITTLE_PARALLAX_STATUSES
from tisfm.metrics import depth_errors, endpoint_error, pose_errors
from tisfm.rigid import pose_matrix
from tisfm.scenes import SyntheticPair, static_scene
from tisfm.scenes.block_scenes import STATIC_KINDS
from tisfm.settings import Motion, Preset, Settings

FOCALS = (320.0, 600.0, 1000.0)  # px, true
# Assumed over true focal length. The paper compares 600 and 1000 px: 5/3 assumes 1000 px for a true
# focal length of 600 px, and 0.6 the reverse.
RATIOS = (0.5, 0.6, 0.75, 0.9, 1.0, 1.1, 4 / 3, 5 / 3, 2.0)
PAPER = ((600.0, 5 / 3), (1000.0, 0.6))  # true focal length, px; ratio
EXACT_THRESHOLD = 0.01  # px, threshold of the essential matrix for the true flow
UNAFFECTED_RATIO = 1.2  # of unaffected depth: maximum ratio to the error at the true focal length
NOTES = (
    "abs-rel is the mean of |ΔZ|/Z after scaling by the median; direction and rotation are errors "
    'of the camera\'s motion, `motion="camera"`; the field is `motion="field"`, with depth by '
    "eq. 24. Offset: c of the best 1/Z′ = a (1/Z + c), in medians of 1/Z. From the true flow: "
    "depth by an essential matrix and triangulation with the same focal length, which shows the "
    "error of the geometry alone. A scene is one pair of frames."
)
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
ROWS = {
    "abs_rel": "depth, abs-rel",
    "direction": "direction, °",
    "rotation": "rotation, °",
    "field_flow": "flow of the field, EPE, px",
}
TICKS = (0.5, 0.75, 1.0, 1.33, 2.0)
MARKERS = ("o", "s", "^", "v")
MAX_DENSE_TICKS_RATIO = 30.0  # of largest to smallest error, for an axis with more ticks
MIN_ERROR = 1e-4  # lower end of a logarithmic axis


@dataclass(frozen=True, kw_only=True)
class Outcome:
    kind: str  # kind of motion of the scene
    focal: float  # the true focal length, px
    ratio: float  # assumed focal length over the true one
    status: str
    # Error of depth, scaled by the median; None if the status says that there is no depth.
    abs_rel: float | None
    # Constant added to the inverse depth, as a share of the scene's median: see `offset_of`.
    offset: float | None
    direction: float | None  # degrees
    rotation: float | None  # degrees
    flow: float  # end-point error, px
    # Error of the depth that an essential matrix and triangulation give for the true flow.
    exact_abs_rel: float
    field_abs_rel: float  # error of the depth of the flow field, by eq. 24
    field_flow: float  # end-point error of the flow field, px


def measure(pair: SyntheticPair, kind: str, ratio: float, preset: Preset) -> Outcome:
    """Interpret a scene with a multiple of its focal length, as one motion and as a field."""
    camera = tisfm.Camera(focal=pair.camera.focal * ratio, center=pair.camera.center)

    def interpret_as(motion: Motion) -> tisfm.Interpretation:
        settings = Settings.preset(preset, motion=motion)
        return tisfm.interpret(pair.frame0, pair.frame1, camera=camera, settings=settings)

    single, field = interpret_as("camera"), interpret_as("field")
    has_depth = single.status not in LITTLE_PARALLAX_STATUSES and single.motions is not None
    exact = two_stage(pair.flow, camera, threshold=EXACT_THRESHOLD)
    errors = None
    if has_depth and single.motions is not None:
        errors = pose_errors(pose_matrix(single.motions[0]), pose_matrix(pair.motions[0]))
    return Outcome(
        kind=kind,
        focal=pair.camera.focal,
        ratio=ratio,
        status=str(single.status),
        abs_rel=depth_errors(single.depth, pair.depth).abs_rel if has_depth else None,
        offset=offset_of(single.inverse_depth, pair.inverse_depth) if has_depth else None,
        direction=errors.direction if errors else None,
        rotation=errors.rotation if errors else None,
        flow=endpoint_error(single.flow, pair.flow),
        exact_abs_rel=depth_errors(depth_of(exact.inverse_depth), pair.depth).abs_rel,
        field_abs_rel=depth_errors(field.depth, pair.depth).abs_rel,
        field_flow=endpoint_error(field.flow, pair.flow),
    )


def offset_of(inverse_depth: NDArray, truth: NDArray) -> float:
    """Return the c, in medians of the truth, for which a (truth + c) fits inverse_depth best.

    Both are (H, W); a is any factor.
    """
    slope, constant = np.polyfit(truth.ravel(), inverse_depth.ravel().astype(np.float64), 1)
    return float(constant / slope / np.median(truth))


def tables(outcomes: Sequence[Outcome]) -> list[str | Table]:
    """Return a heading and a table for every true focal length."""
    head = ["scene", "assumed, px", "ratio", *(title for title, _ in COLUMNS.values())]
    blocks: list[str | Table] = []
    for focal in sorted({outcome.focal for outcome in outcomes}):
        rows = []
        for outcome in (o for o in outcomes if o.focal == focal):
            row = [outcome.kind, f"{outcome.focal * outcome.ratio:.0f}", f"{outcome.ratio:.2f}"]
            for name, (_, form) in COLUMNS.items():
                value = getattr(outcome, name)
                row.append(outcome.status if value is None else format(value, form))
            rows.append(row)
        blocks += [f"## True focal length {focal:g} px", Table(head, rows)]
    return blocks


def finding(outcomes: Sequence[Outcome]) -> str:
    """Return sentences on the paper's pair of focal lengths, and on all ratios."""
    by_case = {(o.kind, o.focal, round(o.ratio, 3)): o for o in outcomes}
    kinds = list(dict.fromkeys(o.kind for o in outcomes))
    sentences = []
    for focal, ratio in PAPER:
        keys = [((kind, focal, 1.0), (kind, focal, round(ratio, 3))) for kind in kinds]
        outcome_pairs = [
            (by_case[right], by_case[wrong])
            for right, wrong in keys
            if right in by_case and wrong in by_case
        ]
        if outcome_pairs:
            sentences.append(_comparison(outcome_pairs))
    rotating = [o for o in outcomes if "rotation" in o.kind and o.offset is not None]
    if rotating:
        low, high = (pick(rotating, key=lambda o: o.offset or 0.0) for pick in (min, max))
        ends = " and ".join(
            f"{o.offset:+.2f} of its median ({o.kind}, {_focal_lengths(o)})" for o in (low, high)
        )
        sentences.append(
            "At a wrong focal length, a part of the image motion by rotation looks like parallax: "
            f"it acts as a constant added to 1/Z, between {ends}. Where 1/Z falls to 0 or below, "
            "depth is lost and the direction may be the opposite one; the same happens with the "
            "true flow."
        )
    for name, title in (("field_flow", "flow"), ("field_abs_rel", "depth, by eq. 24,")):
        factors = [
            getattr(o, name) / getattr(by_case[o.kind, o.focal, 1.0], name) for o in outcomes
        ]
        sentences.append(
            f"The field's {title} changes its error by factors of {min(factors):.2f} to "
            f"{max(factors):.2f} over all ratios."
        )
    return " ".join(sentences)


def _comparison(outcome_pairs: Sequence[tuple[Outcome, Outcome]]) -> str:
    """Return which scenes keep their error of depth at the second focal length."""
    unaffected: list[str] = []
    affected: list[str] = []
    for right, wrong in outcome_pairs:
        if right.abs_rel is None or wrong.abs_rel is None:
            affected.append(f"{right.kind} ({right.status} → {wrong.status})")
            continue
        text = f"{right.kind} ({right.abs_rel:.4f} → {wrong.abs_rel:.4f}, direction "
        text += f"{right.direction:.2f}° → {wrong.direction:.2f}°, rotation "
        text += f"{right.rotation:.3f}° → {wrong.rotation:.3f}°)"
        (unaffected if wrong.abs_rel <= UNAFFECTED_RATIO * right.abs_rel else affected).append(text)
    return (
        f"{_focal_lengths(outcome_pairs[0][1])}: abs-rel is at most {UNAFFECTED_RATIO - 1:.0%} "
        f"worse in {', '.join(unaffected) or 'no scene'}; it is worse than that in "
        f"{', '.join(affected) or 'no scene'}."
    )


def _focal_lengths(outcome: Outcome) -> str:
    return f"{outcome.focal * outcome.ratio:.0f} px assumed for true {outcome.focal:g} px"


def report(outcomes: Sequence[Outcome], conditions: Mapping[str, Any]) -> str:
    picture = "![Errors over the ratio of the two focal lengths](focal.png)"
    title = "# A wrong focal length"
    return markdown_page(title, conditions, NOTES, picture, finding(outcomes), *tables(outcomes))


def picture(outcomes: Sequence[Mapping[str, Any]]) -> Figure:
    """Return a row of axes for every error and a column for every true focal length.

    Outcomes have the fields of `Outcome`.
    """
    focals = sorted({outcome["focal"] for outcome in outcomes})
    kinds = list(dict.fromkeys(outcome["kind"] for outcome in outcomes))
    size = (3.2 * len(focals) + 0.4, 2.1 * len(ROWS) + 0.8)
    figure = Figure(figsize=size, dpi=130, layout="constrained")
    grid = figure.subplots(len(ROWS), len(focals), sharex=True, sharey="row", squeeze=False)
    for row, (name, title) in enumerate(ROWS.items()):
        for column, focal in enumerate(focals):
            axes = grid[row, column]
            for kind, colour, marker in zip(kinds, CURVES, MARKERS, strict=False):
                points = [o for o in outcomes if (o["kind"], o["focal"]) == (kind, focal)]
                known_points = [
                    (o["ratio"], max(o[name], MIN_ERROR)) for o in points if o[name] is not None
                ]
                if known_points:
                    axes.plot(
                        *zip(*known_points, strict=True),
                        marker=marker,
                        color=colour,
                        markersize=4,
                        linewidth=1.2,
                        label=kind,
                    )
            _scale(axes, [o[name] for o in outcomes if o[name] is not None])
            if row == 0:
                axes.set_title(f"true focal length {focal:g} px", fontsize=10)
            if column == 0:
                axes.set_ylabel(title, fontsize=9)
            if row == len(ROWS) - 1:
                axes.set_xlabel("assumed / true focal length", fontsize=9)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(kinds), fontsize=9)
    return figure


def _scale(axes: Axes, values: Sequence[float]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(FixedLocator(TICKS))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    if max(values) < MAX_DENSE_TICKS_RATIO * max(min(values), MIN_ERROR):
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.axvline(1.0, color="0.6", linewidth=0.8, linestyle=":")
    tidy(axes)
    axes.tick_params(labelsize=8)


def main(arguments: list[str] | None = None) -> int:
    parser = options_parser("focal", __doc__, "threads", "output")
    parser.add_argument("--height", type=int, default=240, help="px")
    parser.add_argument("--width", type=int, default=320, help="px")
    parser.add_argument("--preset", choices=get_args(Preset), default="balanced")
    options = parser.parse_args(arguments)
    runtime.start(threads=options.threads)
    size = (options.height, options.width)
    outcomes = []
    for focal in FOCALS:
        for kind in STATIC_KINDS:
            pair = static_scene(kind, *size, focal=focal)
            outcomes += [measure(pair, kind, ratio, options.preset) for ratio in RATIOS]
    conditions = {
        "command": command_text("focal", options, ["preset"]),
        "scenes": f"`tisfm.scenes.static_scene`, {options.height}×{options.width}",
        "preset": options.preset,
        "threads": options.threads,
        **machine(),
    }
    text = report(outcomes, conditions)
    print(text)
    path = RESULTS / (options.output or "focal")
    records = [asdict(outcome) for outcome in outcomes]
    write_results(path, text, {**conditions, "found": records})
    picture(records).savefig(path.with_suffix(".png"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
