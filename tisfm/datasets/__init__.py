"""Frame pairs and sequences with true motion, depth or poses, in the layouts of usual benchmarks.

Middlebury, KITTI 2012 and 2015, Sintel, Yosemite, stereo pairs with a disparity, and sequences with
poses: New Tsukuba, 7-Scenes, TUM RGB-D, KITTI's odometry, and any sequence as a folder of images
with camera, poses and depth maps. Nothing is downloaded: `find_pairs` and `find_sequences` search a
folder, and `load` reads the files.

May import: `tisfm.formats`, `tisfm.metrics`, `tisfm.trajectory`, and of the top level `camera`,
`checks` and `rigid`.
"""

from tisfm.datasets.pair import DatasetPair, LoadedPair
from tisfm.datasets.pair_layouts import LAYOUTS, Layout
from tisfm.datasets.search import DatasetSequence, find_pairs, find_sequences
from tisfm.datasets.sequence import LoadedSequence
from tisfm.datasets.sequence_layouts import SEQUENCE_LAYOUTS, SequenceLayout

__all__ = [
    "LAYOUTS",
    "SEQUENCE_LAYOUTS",
    "DatasetPair",
    "DatasetSequence",
    "Layout",
    "LoadedPair",
    "LoadedSequence",
    "SequenceLayout",
    "find_pairs",
    "find_sequences",
]
