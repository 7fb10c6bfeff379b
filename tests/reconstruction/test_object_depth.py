"""Depth of an object from the part of the frames that shows it, compared with whole frames."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from tests.rendered import bodies_film
from tisfm.camera import Camera
from tisfm.reconstruction.depth.segment_depth import PieceDepths, depth_effort
from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.objects import object_path as own_path
from tisfm.reconstruction.objects.object_path import BOX_ALIGNMENT, find_object_depths
from tisfm.reconstruction.tracks.tracker import Tracker
from tisfm.reconstruction.tracks.triangulation import triangulate_tracks
from tisfm.scenes import bodies_path
from tisfm.settings import Settings
from tisfm.sources.frame_reader import SourceFrame

SETTINGS = Settings.preset("fast")
SIZE = 181, 243
COUNT = 8


@cache
def film():
    """Return a film of a room at rest."""
    return bodies_film(bodies_path(COUNT), *SIZE, bodies=0)


class Part:
    """Frames with one fixed mask of the pixels that count."""

    def __init__(self, counted):
        self.camera, self.shape = film().camera, SIZE
        self._counted = counted

    def grey(self, number):
        return film().frames[number].astype(np.float32)

    def used_pixels(self, number):
        return self._counted


def part(where):
    """Return the mask of an object, in the middle or at a corner."""
    rows, columns = np.indices(SIZE)
    if where == "midst":
        return ((rows - 91) / 37) ** 2 + ((columns - 118) / 45) ** 2 < 1
    return (rows > 109) & (columns > 160)


@pytest.mark.parametrize("where", ["midst", "corner"])
def test_depth_of_an_object_equals_that_of_whole_frames(where):
    counted = part(where)
    frames = Part(counted)
    tracker = Tracker(frames.camera, TRACKING_SETTINGS, cells=48)
    seen = [tracker.track(np.uint8(frames.grey(k)), ~counted) for k in range(COUNT)]
    poses = {k: film().poses[k] for k in range(COUNT)}
    points = triangulate_tracks(seen, poses, frames.camera, SIZE)
    piece = Piece(poses=poses, views=tuple(poses), points=points)
    cut = find_object_depths(frames, piece, seen, SETTINGS)
    whole = list(PieceDepths(frames, piece, seen, SETTINGS, effort=depth_effort(SETTINGS)))
    assert [one.frame for one in cut] == [one.frame for one in whole]
    for one, other in zip(cut, whole, strict=True):
        assert one.inverse_depth.shape == one.deviation.shape == SIZE
        differ = np.abs(one.inverse_depth / other.inverse_depth - 1)[counted]
        assert np.median(differ) < 0.01  # planes are drawn at random
        true = film().depth[one.frame][counted]
        off, off_whole = (np.abs(d.inverse_depth[counted] * true - 1).mean() for d in (one, other))
        assert off < 1.3 * off_whole + 0.003
        known = np.isfinite(one.inverse_depth)
        assert known[counted].all() and known.mean() < 0.6
        assert not np.isfinite(one.deviation[~counted]).any()
    rows, columns = own_path._bounding_box(frames, range(COUNT))
    assert rows.start % BOX_ALIGNMENT == columns.start % BOX_ALIGNMENT == 0
    assert rows.stop <= SIZE[0] and columns.stop <= SIZE[1]


def test_image_motion_is_unknown_after_a_frame_without_the_object():
    frames = SimpleNamespace(camera=Camera(), shape=SIZE, flow=lambda number: number)
    seen = own_path._ObjectFrames(frames, [2, 3, 5, 6], 1)
    assert [seen.flow(number) for number in range(4)] == [None, 3, None, 6]


def test_flow_is_computed_again_for_corrected_frames(tmp_path):
    for name in ("cache", "frames"):
        (tmp_path / name).mkdir()
    frames = PreparedFrames(Camera(focal=90.0), tmp_path / "cache", tmp_path / "frames")
    for k in range(2):
        image = film().frames[4 * k]
        frames.add(SourceFrame(index=k, name=str(k), time=None, image=image))
    assert frames.flow(0) is None
    before = frames.flow(1)
    np.testing.assert_array_equal(frames.flow(1), before)
    frames.correct(Camera(focal=90.0, distortion=(0.15, 0, 0, 0)))
    assert np.abs(frames.flow(1) - before).max() > 0.1
