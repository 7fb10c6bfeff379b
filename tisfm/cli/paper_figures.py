"""The paper's comparisons of settings, as figures (its Fig. 6 and 8)."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera
from tisfm.formats.result_folder import InputFiles, make_folder
from tisfm.pair import interpret
from tisfm.settings import PAPER_SMOOTHNESS, Settings
from tisfm.show import depth_grey, inverse_depth_limit, panel_figure, save_figure

PAPER_FIGURES = ("figure_lambda.png", "figure_presmoothing.png", "figure_contrast.png")
PRESMOOTHING = 1.5  # px; the paper does not say which Gaussian it used


def write_paper_figures(
    folder: str | Path,
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera,
    known: Mapping[Settings, np.ndarray] | None = None,
    inputs: InputFiles | None = None,
) -> list[Path]:
    """Write three figures of the depth of a pair under different settings.

    ``figure_lambda.png``: the preset ``"paper"`` with λ = 1e8 and 1e9 at f = 600 (Fig. 6).
    ``figure_presmoothing.png``: without and with a Gaussian applied to the frames first (Fig. 8).
    ``figure_contrast.png``: the default preset with the paper's contrast, δ = 1 in the units of
    τ, and with the default one: under the paper's, b stays at 1 and no edge is preserved.
    Both panels of a figure have one grey scale.

    Parameters
    ----------
    folder : path
        Made if it does not exist.
    frame0, frame1, camera
        As for `tisfm.interpret`.
    known : mapping of Settings to (H, W), optional
        Inverse depth of these frames under settings that need not be interpreted again.
    inputs : InputFiles, optional
        Files that are not to be replaced.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    OSError
        If they cannot be written.
    TypeError, ValueError
        As `tisfm.interpret`; if one of them is an input.
    """
    (inputs or InputFiles()).refuse(*(Path(folder) / name for name in PAPER_FIGURES))
    folder = make_folder(folder)
    paper, default = Settings.preset("paper"), Settings()
    comparisons = {
        "figure_lambda.png": (
            "Smoothness λ (Fig. 6)",
            {
                "λ = 1e8": paper,
                "λ = 1e9": replace(paper, smoothness=10 * PAPER_SMOOTHNESS),
            },
        ),
        "figure_presmoothing.png": (
            "Smoothing the frames first (Fig. 8)",
            {
                "frames as they are": paper,
                f"Gaussian of {PRESMOOTHING:g} px": replace(paper, presmoothing=PRESMOOTHING),
            },
        ),
        "figure_contrast.png": (
            "Contrast δ: edges that blur, and edges that stay",
            {
                "δ = f px, the paper's": replace(default, contrast=None),
                f"δ = {default.contrast:g} px, the default": default,
            },
        ),
    }
    depth_of = dict(known or {})
    written = []
    for name, (title, panels) in comparisons.items():
        for settings in panels.values():
            if settings not in depth_of:
                result = interpret(frame0, frame1, camera=camera, settings=settings)
                depth_of[settings] = result.inverse_depth
        depths = [depth_of[settings] for settings in panels.values()]
        limit = max(inverse_depth_limit(depth) for depth in depths) or None
        pictures = [
            (label, depth_grey(depth, limit=limit))
            for label, depth in zip(panels, depths, strict=True)
        ]
        (inputs or InputFiles()).refuse(folder / name)
        save_figure(folder / name, panel_figure(pictures, title=title))
        written.append(folder / name)
    return written
