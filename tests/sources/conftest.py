"""Fixtures of the tests of sources."""

from tests.sources.made import folder, video

__all__ = ["folder", "video"]
