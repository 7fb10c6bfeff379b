"""``tisfm demo``: its arguments."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg


@dataclass(kw_only=True)
class Demo:
    """Render scenes whose truth is known, interpret them, and compare.

    Two textured blocks move each on its own, in front of a background and on a floor, before a
    camera that moves sideways: errors against the truth of the preset "paper", the default preset
    and Horn and Schunck. Three blocks at rest, before a camera that moves forward and turns:
    errors of motion "field" and "camera". DIR receives every output of `tisfm run` for the first
    scene and the paper's comparisons of settings, DIR/camera and DIR/objects those of the
    motions "camera" and "objects".
    """

    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")] = Path("tisfm-demo")
    """Folder for the results; made if need be."""
    height: int = 240
    """Height of the rendered frames, px."""
    width: int = 320
    """Width of the rendered frames, px."""
    seed: int = 0
    """Seed of the textures."""
    threads: int | None = None
    """Most CPU threads; by default all cores."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.demo import demo

        return demo(
            self.output, height=self.height, width=self.width, seed=self.seed, threads=self.threads
        )
