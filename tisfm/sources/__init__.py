"""Sources of frames: video, folder, glob, list of files, iterable of arrays, webcam.

`FrameSource` is the door: it opens a source, crops and shrinks its frames, gives each its time and
its mask and labels, and reads files ahead in a thread.

May import: `tisfm.formats`, and of the top level `camera`, `checks`, `frames`, `interpretation`,
`pair`, `settings` and `window`.
"""

from tisfm.sources.frame_reader import Listing, SourceFrame
from tisfm.sources.pairs import FramePair
from tisfm.sources.source import BadFrames, FrameSource, Source

__all__ = ["BadFrames", "FramePair", "FrameSource", "Listing", "Source", "SourceFrame"]
