"""Files: optical flow, pictures and depth.

Readers refuse a file that is not complete, with a `FormatError` that names it; writers leave a
complete file or none.
"""

from .atomic import atomic_write
from .depth_png import choose_depth_scale, read_depth_png, write_depth_png
from .errors import FormatError
from .flo import read_flo, write_flo
from .images import IMAGE_SUFFIXES, read_image, write_png

__all__ = [
    "IMAGE_SUFFIXES",
    "FormatError",
    "atomic_write",
    "choose_depth_scale",
    "read_depth_png",
    "read_flo",
    "read_image",
    "write_depth_png",
    "write_flo",
    "write_png",
]
