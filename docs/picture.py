"""``python docs/picture.py``: draw the README's pictures from rendered scenes.

``docs/demo.png`` is the scene of ``tisfm demo`` in which two blocks on a floor move each on its
own before a camera that moves sideways. ``docs/demo.webp`` is the animation that the demo writes:
three blocks at rest, seen by a camera that moves forward and turns.
"""

from pathlib import Path

import tisfm
from tisfm.cli.demo_animation import write_animation
from tisfm.scenes import static_scene, two_blocks
from tisfm.show import depth_to_color, flow_to_color, label_overlay, panel_figure, save_figure

PICTURE = Path(__file__).with_name("demo.png")
ANIMATION = Path(__file__).with_name("demo.webp")
DPI = 78  # keeps the file below 150 KB


def draw(path: Path, height: int = 240, width: int = 320) -> None:
    """Interpret the scene and write a picture of the result."""
    scene = two_blocks(height, width)
    settings = tisfm.Settings(motion="objects", align_scales=True)
    result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)
    assert result.labels is not None  # this motion model has them
    panels = [
        ("The first of two frames", result.frame),
        ("What moves on its own", label_overlay(result.frame, result.labels)),
        ("Depth, near is bright", depth_to_color(result.inverse_depth)),
        ("Image motion, hue for direction", flow_to_color(result.flow)),
    ]
    save_figure(path, panel_figure(panels, columns=4), dpi=DPI)


def animate(path: Path, height: int = 240, width: int = 320) -> None:
    """Interpret the scene at rest and write an animation of the result."""
    scene = static_scene("forward+rotation", height, width)
    settings = tisfm.Settings(motion="camera")
    result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)
    write_animation(path, result)


if __name__ == "__main__":
    draw(PICTURE)
    animate(ANIMATION)
