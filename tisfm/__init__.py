"""Dense structure and 3D motion from image sequences, on a CPU, without training."""

import sys
from importlib import import_module
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType

from tisfm.doctor.answering import answer, is_asked
from tisfm.machine.address_space import require_for_import

if is_asked():  # where the libraries below crash or hang, the doctor says so
    answer()
if "cv2" not in sys.modules:  # OpenCV crashes below this, with one thread and with several
    require_for_import(0.28e9, more_with_threads=0.19e9)

from tisfm.camera import Camera
from tisfm.interpretation import Interpretation
from tisfm.pair import interpret
from tisfm.reconstruction.entry import reconstruct
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.streaming.entry import reconstruct_stream
from tisfm.reconstruction.streaming.streamed_frame import StreamedFrame
from tisfm.sequence import interpret_sequence
from tisfm.settings import Settings
from tisfm.version import __version__

__all__ = [
    "Camera",
    "Interpretation",
    "MovingObject",
    "Reconstruction",
    "Settings",
    "StreamedFrame",
    "__version__",
    "interpret",
    "interpret_sequence",
    "reconstruct",
    "reconstruct_stream",
]

_SUBMODULES = (
    "camera_file",
    "datasets",
    "egomotion",
    "errors",
    "evaluation",
    "exports",
    "focal_guess",
    "formats",
    "horn_schunck",
    "lens",
    "metrics",
    "rigid",
    "runtime",
    "scenes",
    "show",
    "trajectory",
)


class _KernelsOfCheckout:
    """Finds `tisfm.kernels` beside this package.

    That is where it lies in a checkout. Python started there takes this folder for the package,
    whatever is installed.
    """

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name != "tisfm.kernels":
            return None
        return spec_from_file_location(name, Path(__file__).parents[1] / "kernels" / "__init__.py")


if not Path(__file__).with_name("kernels").is_dir():
    sys.meta_path.append(_KernelsOfCheckout)


def __getattr__(name: str) -> ModuleType:
    """Load a submodule when it is first named, so that ``import tisfm`` stays fast."""
    if name in _SUBMODULES:
        return import_module(f"tisfm.{name}")
    raise AttributeError(f"module 'tisfm' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, *_SUBMODULES]
