"""Options that say which frames of a source are taken, and what part of them."""

from dataclasses import asdict, dataclass
from typing import Annotated

from tyro.conf import arg

from tisfm.sources import BadFrames, FrameSource, Source


@dataclass(frozen=True, kw_only=True)
class FrameOptions:
    """The frames that are taken, and what part of them."""

    step: int = 1
    """Take every STEP-th frame, for slow motion."""
    start: int = 0
    """Number of the first frame that is taken; the first of the source is 0."""
    stop: int | None = None
    """Number of the first frame that is not taken any more. By default all are."""
    size: int | None = None
    """Longer side of the frames, px: larger frames are shrunk. Give the camera and --focal for the
    frames before shrinking."""
    crop: Annotated[tuple[int, int, int, int] | None, arg(metavar="LEFT TOP WIDTH HEIGHT")] = None
    """Use this part of the frames alone, px. It is cut out before the rest is shrunk."""
    bad_frames: BadFrames = "raise"
    """What becomes of damaged frames: an error, or they are left out."""

    def open(self, source: Source, *, mask: str | None = None) -> FrameSource:
        """Open a source, with its masks."""
        return FrameSource(source, mask=mask, **asdict(self))
