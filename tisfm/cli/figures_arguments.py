"""``tisfm figures``: its arguments."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from tisfm.cli.shared_options import CameraOptions


@dataclass(kw_only=True)
class Figures:
    """Draw the paper's comparisons of settings (its Fig. 6 and 8) for two frames of yours.

    Depth for λ = 1e8 and 1e9, with and without smoothing the frames first, and with the paper's
    contrast, which is inert, beside the default one.
    """

    frames: Annotated[Positional[tuple[str, str]], arg(metavar="FRAME FRAME")]
    """Two images."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for the figures; made if need be."""
    threads: int | None = None
    """Most CPU threads; by default all cores."""
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.commands import figures

        return figures(
            self.frames,
            self.output,
            camera=self.camera.camera(),
            guess=self.camera.guess("field"),
            threads=self.threads,
        )
