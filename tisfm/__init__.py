"""Dense structure and 3D motion from image sequences, on a CPU, without training."""

from importlib import import_module
from pathlib import Path
from types import ModuleType

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

_SUBMODULES = (
    "datasets",
    "evaluation",
    "formats",
    "horn_schunck",
    "metrics",
    "reference",
    "runtime",
    "scenes",
    "show",
)

# Installed, `tisfm.kernels` lies in this folder; in a checkout, `kernels` lies beside it. Python
# started in a checkout takes this folder for the package, whatever is installed.
if not Path(__file__).with_name("kernels").is_dir():
    __path__.append(str(Path(__file__).parents[1]))


def __getattr__(name: str) -> ModuleType:
    """Load a submodule when it is first named, so that ``import tisfm`` stays fast."""
    if name in _SUBMODULES:
        return import_module(f"tisfm.{name}")
    raise AttributeError(f"module 'tisfm' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, *_SUBMODULES]
