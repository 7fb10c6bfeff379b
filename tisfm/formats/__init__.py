"""Files of optical flow, depth, images, labels and arrays.

Readers refuse an incomplete file with a `FormatError` that names it. Writers leave a complete file
or none, and refuse arrays with masked values, which no format can store.

May import: of the top level `checks`.
"""

from tisfm.formats.atomic import atomic_write
from tisfm.formats.depth_png import choose_depth_scale, read_depth_png, write_depth_png
from tisfm.formats.float_maps import read_dpt, read_flo, write_dpt, write_flo
from tisfm.formats.images import IMAGE_SUFFIXES, read_image, write_png
from tisfm.formats.kitti_flow import read_kitti_flow, write_kitti_flow
from tisfm.formats.reading import FormatError

__all__ = [
    "IMAGE_SUFFIXES",
    "FormatError",
    "atomic_write",
    "choose_depth_scale",
    "read_depth_png",
    "read_dpt",
    "read_flo",
    "read_image",
    "read_kitti_flow",
    "write_depth_png",
    "write_dpt",
    "write_flo",
    "write_kitti_flow",
    "write_png",
]
