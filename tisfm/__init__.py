"""Dense structure and 3D motion from image sequences, on a CPU, without training.

``import tisfm`` imports no other package: each name is loaded when it is first used.
"""

import sys
from importlib import import_module
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tisfm.camera import Camera
    from tisfm.grade import Grade
    from tisfm.interpretation import Interpretation
    from tisfm.pair import interpret
    from tisfm.reconstruction.entry import reconstruct
    from tisfm.reconstruction.result.moving_object import MovingObject
    from tisfm.reconstruction.result.path_check import PairEvidence, PathCheck
    from tisfm.reconstruction.result.reconstruction import Reconstruction
    from tisfm.reconstruction.streaming.entry import reconstruct_stream
    from tisfm.reconstruction.streaming.streamed_frame import StreamedFrame
    from tisfm.sequence import interpret_sequence
    from tisfm.settings import Settings
    from tisfm.version import __version__

__all__ = [
    "Camera",
    "Grade",
    "Interpretation",
    "MovingObject",
    "PairEvidence",
    "PathCheck",
    "Reconstruction",
    "Settings",
    "StreamedFrame",
    "__version__",
    "interpret",
    "interpret_sequence",
    "reconstruct",
    "reconstruct_stream",
]

_MODULE_BY_NAME = {
    "Camera": "tisfm.camera",
    "Grade": "tisfm.grade",
    "Interpretation": "tisfm.interpretation",
    "MovingObject": "tisfm.reconstruction.result.moving_object",
    "PairEvidence": "tisfm.reconstruction.result.path_check",
    "PathCheck": "tisfm.reconstruction.result.path_check",
    "Reconstruction": "tisfm.reconstruction.result.reconstruction",
    "Settings": "tisfm.settings",
    "StreamedFrame": "tisfm.reconstruction.streaming.streamed_frame",
    "__version__": "tisfm.version",
    "interpret": "tisfm.pair",
    "interpret_sequence": "tisfm.sequence",
    "reconstruct": "tisfm.reconstruction.entry",
    "reconstruct_stream": "tisfm.reconstruction.streaming.entry",
}
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


class _CheckoutKernelsFinder:
    """Finds the package `tisfm.kernels` in a checkout, where it lies beside this package.

    Python started in the root of the checkout imports the folder ``tisfm`` of the checkout, even
    if another version is installed.
    """

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name != "tisfm.kernels":
            return None
        return spec_from_file_location(name, Path(__file__).parents[1] / "kernels" / "__init__.py")


if not Path(__file__).with_name("kernels").is_dir():
    sys.meta_path.append(_CheckoutKernelsFinder)


def __getattr__(name: str) -> Any:
    """Load a public name or a submodule when it is first used."""
    if name in _MODULE_BY_NAME:
        value = getattr(import_module(_MODULE_BY_NAME[name]), name)
        globals()[name] = value  # the next use finds it without this function
        return value
    if name in _SUBMODULES:
        return import_module(f"tisfm.{name}")
    raise AttributeError(f"module 'tisfm' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, *_SUBMODULES]
