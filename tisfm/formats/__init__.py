"""Files: optical flow, pictures and depth.

Readers refuse a file that is not complete, with a `FormatError` that names it; writers leave a
complete file or none.
"""

from tisfm.formats.atomic import atomic_write
from tisfm.formats.depth_png import choose_depth_scale, read_depth_png, write_depth_png
from tisfm.formats.errors import FormatError
from tisfm.formats.flo import read_flo, write_flo
from tisfm.formats.images import IMAGE_SUFFIXES, read_image, write_png

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
