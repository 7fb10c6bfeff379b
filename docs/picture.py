"""``python docs/picture.py``: draw the README's picture, ``docs/demo.png``, from a rendered scene.

It is the scene of ``tisfm demo``: two blocks on a floor, which move each on its own before a camera
that moves sideways.
"""

from pathlib import Path

import tisfm
from tisfm.scenes import two_blocks
from tisfm.show import depth_grey, flow_to_color, label_overlay, panel_figure, save_figure

PICTURE = Path(__file__).with_name("demo.png")
DPI = 85  # keeps the file below 150 KB


def draw(path: Path, height: int = 240, width: int = 320) -> None:
    """Interpret the scene and write a picture of the result."""
    scene = two_blocks(height, width)
    settings = tisfm.Settings(motion="objects", align_scales=True)
    result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)
    assert result.labels is not None  # this motion model has them
    panels = [
        ("The first of two frames", result.frame),
        ("What moves on its own", label_overlay(result.frame, result.labels)),
        ("Depth, near is bright", depth_grey(result.inverse_depth)),
        ("Image motion, hue for direction", flow_to_color(result.flow)),
    ]
    save_figure(path, panel_figure(panels, columns=4), dpi=DPI)


if __name__ == "__main__":
    draw(PICTURE)
