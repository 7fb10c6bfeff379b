"""Sources of frames: videos, folders, glob patterns, lists of files, iterables of arrays, webcams.

`FrameSource` is the entry point. A frame source opens a source, crops and shrinks its frames, adds
the time, the mask and the labels of each frame, and reads files ahead in a thread.

May import: `tisfm.formats`, and of the top level `camera`, `checks`, `frames`, `interpretation`,
`pair`, `settings` and `window`.
"""

from tisfm.sources.frame_reader import Listing, SourceFrame
from tisfm.sources.pairs import FramePair
from tisfm.sources.source import BadFrames, FrameSource, Source

__all__ = ["BadFrames", "FramePair", "FrameSource", "Listing", "Source", "SourceFrame"]
