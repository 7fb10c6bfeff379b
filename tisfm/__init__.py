"""Dense structure and 3D motion from image sequences, on a CPU, without training."""

from tisfm.camera import Camera
from tisfm.interpretation import Interpretation
from tisfm.pair import interpret
from tisfm.sequence import interpret_sequence
from tisfm.settings import Settings
from tisfm.version import __version__

__all__ = [
    "Camera",
    "Interpretation",
    "Settings",
    "__version__",
    "interpret",
    "interpret_sequence",
]
