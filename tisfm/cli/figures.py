"""``tisfm figures``: the comparisons of settings in the figures 6 and 8 of the paper."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from tyro.conf import OmitArgPrefixes, Positional, arg

from tisfm.camera import Camera
from tisfm.cli.console import start_kernels, tell
from tisfm.cli.options import CameraOptions
from tisfm.folders.result_folder import InputFiles, make_result_folder
from tisfm.pair import interpret
from tisfm.running.sequence_run import guess_camera_focal, load_camera
from tisfm.settings import PAPER_SMOOTHNESS, Settings
from tisfm.show import depth_grey, inverse_depth_limit, panel_figure, save_figure
from tisfm.sources import FrameSource


@dataclass(kw_only=True)
class Figures:
    """Draw comparisons of settings for two of your frames.

    The comparisons are those of Fig. 6 and 8 in the paper of Sekkati and Mitiche (2007). They show
    depth for the smoothness λ = 1e8 and 1e9; with and without smoothing of the frames; and with the
    paper's contrast, which has no effect, and the default contrast.
    """

    frames: Annotated[Positional[tuple[str, str]], arg(metavar="FRAME FRAME")]
    """Two images."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for the figures; made if it does not exist."""
    threads: int | None = None
    """Maximum number of CPU threads. By default all cores."""
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        return figures(
            self.frames,
            self.output,
            camera=self.camera.camera(),
            guess=self.camera.guess("field"),  # the motion model of the paper
            threads=self.threads,
        )


def figures(
    frames: Sequence[str],
    output: Path,
    *,
    camera: Camera | Path,
    guess: bool = False,
    threads: int | None,
) -> int:
    """Draw the paper's comparisons of settings for two image files.

    `guess` says whether to guess the focal length from the EXIF data of the first file.
    """
    pairs = FrameSource(tuple(frames))
    inputs = InputFiles(pairs.files)
    start_kernels(None, threads=threads)
    for pair in pairs:
        if isinstance(camera, Path):
            camera = load_camera(camera, pair.frame0.shape[:2], tell)
        elif guess:
            camera = guess_camera_focal(camera, pairs.files[0], tell)
        files = write_paper_figures(output, pair.frame0, pair.frame1, camera=camera, inputs=inputs)
        tell("wrote " + ", ".join(map(str, files)))
    return 0


PAPER_FIGURES = ("figure_lambda.png", "figure_presmoothing.png", "figure_contrast.png")
PRESMOOTHING = 1.5  # px; the paper does not state its Gaussian


def write_paper_figures(
    folder: str | Path,
    frame0: npt.ArrayLike,
    frame1: npt.ArrayLike,
    *,
    camera: Camera,
    known_depth: Mapping[Settings, np.ndarray] | None = None,
    inputs: InputFiles | None = None,
) -> list[Path]:
    """Write three figures of the depth of a pair under different settings.

    ``figure_lambda.png``: the preset ``"paper"`` with λ = 1e8 and 1e9 at f = 600 (Fig. 6).
    ``figure_presmoothing.png``: without and with a Gaussian applied to the frames first (Fig. 8).
    ``figure_contrast.png``: the default preset with the paper's contrast, and with the default
    contrast. The paper has δ = 1 for τ = T/Z, translation over depth: this is δ = f px for ρ̂ = f τ.
    With the paper's contrast, smoothness weakens nowhere and no edge is preserved.
    Both panels of a figure have the same grey scale.

    Parameters
    ----------
    folder : path
        Made if it does not exist.
    frame0, frame1, camera
        As for `tisfm.interpret`.
    known_depth : mapping of Settings to (H, W), optional
        Inverse depth of these frames by settings, computed before; other settings are computed.
    inputs : InputFiles, optional
        Files that no figure may replace.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    OSError
        If a file cannot be written.
    TypeError, ValueError
        As `tisfm.interpret`; if a figure would replace an input.
    """
    (inputs or InputFiles()).refuse(*(Path(folder) / name for name in PAPER_FIGURES))
    folder = make_result_folder(folder)
    paper, default = Settings.preset("paper"), Settings()
    comparisons = {
        "figure_lambda.png": (
            "Smoothness λ (Fig. 6)",
            {"λ = 1e8": paper, "λ = 1e9": replace(paper, smoothness=10 * PAPER_SMOOTHNESS)},
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
    depth_by_settings = dict(known_depth or {})
    files = []
    for name, (title, panels) in comparisons.items():
        for settings in panels.values():
            if settings not in depth_by_settings:
                result = interpret(frame0, frame1, camera=camera, settings=settings)
                depth_by_settings[settings] = result.inverse_depth
        depths = [depth_by_settings[settings] for settings in panels.values()]
        limit = max(inverse_depth_limit(depth) for depth in depths) or None
        pictures = [
            (label, depth_grey(depth, limit=limit))
            for label, depth in zip(panels, depths, strict=True)
        ]
        (inputs or InputFiles()).refuse(folder / name)
        save_figure(folder / name, panel_figure(pictures, title=title))
        files.append(folder / name)
    return files
