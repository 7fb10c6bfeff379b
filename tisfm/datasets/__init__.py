"""Frame pairs with true motion, depth or pose, in the folder layouts of the usual benchmarks.

Middlebury, KITTI 2012 and 2015, Sintel, Yosemite, stereo pairs with a disparity, and sequences with
poses: New Tsukuba, 7-Scenes, and any that comes as a folder of images with camera, poses and
depth maps. Nothing is downloaded: `find_pairs` finds what lies in a folder,
and reads it when asked to.

May import: `tisfm.formats`, `tisfm.metrics`, and of the top level `camera` and `rigid`.
"""

from tisfm.datasets.finding import find_pairs
from tisfm.datasets.layouts import LAYOUTS, Layout
from tisfm.datasets.pair import DatasetPair, LoadedPair

__all__ = ["LAYOUTS", "DatasetPair", "Layout", "LoadedPair", "find_pairs"]
