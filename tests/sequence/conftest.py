"""Fixtures of the tests of sequences."""

from tests.sources.made import folder, video

__all__ = ["folder", "video"]
