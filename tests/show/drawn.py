"""What the tests of figures draw, and how they look at it."""

import numpy as np


def scene(height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Make a frame, inverse depth and flow of two planes, seen from a camera that moves forward."""
    rng = np.random.default_rng(height * width)
    y, x = np.mgrid[:height, :width] - np.array([height - 1, width - 1]).reshape(2, 1, 1) / 2
    inverse_depth = np.where((abs(x) < width / 4) & (abs(y) < height / 4), 1.0, 0.3)
    flow = np.stack([x, y], axis=2) * (inverse_depth / max(width, height))[..., None]
    frame = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    return frame, inverse_depth, flow


def drawn_parts(figure):
    """Return panels (axes with a picture), and the arrows of those that have some."""
    from matplotlib.quiver import Quiver

    panels = [axes for axes in figure.axes if axes.get_images()]
    arrows = [
        artist for axes in panels for artist in axes.collections if isinstance(artist, Quiver)
    ]
    return panels, arrows


def written(figure):
    """Return all that is written in a figure."""
    from matplotlib.text import Text

    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def overlapping(boxes):
    """Return the pairs of boxes that overlap by more than a hair."""
    return [
        (i, j)
        for i, a in enumerate(boxes)
        for j, b in enumerate(boxes[:i])
        if min(a.x1, b.x1) - max(a.x0, b.x0) > 0.01 and min(a.y1, b.y1) - max(a.y0, b.y0) > 0.01
    ]
