"""Labels and path of the static pixels: when the path of all pixels counts.

The search for labels and the search for paths are stand-ins that note how they are called.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from tests.rendered import bodies_film
from tisfm.camera import Camera
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels
from tisfm.reconstruction.objects.static_path import find_static_path
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.scenes import bodies_path
from tisfm.sources.frame_reader import SourceFrame

COUNT, SHAPE = 4, (20, 30)
NO_LABELS, FEW_LABELS, OTHER_LABELS = 0.0, 0.2, 0.3  # shares of a frame
MOST_LABELS = 0.9


def path_of(positions, focal=50.0):
    """Return a path whose first frames have positions."""
    piece = Piece(poses={k: np.eye(4) for k in range(positions)}, views=(0,), points={})
    pieces = (piece,) if positions else ()
    return CameraPath(pieces=pieces, missing={}, observations=(), camera=Camera(focal=focal))


@dataclass
class Labels:
    """A stand-in for the search for labels: each call returns the next of its shares."""

    shares: list
    calls: list = field(default_factory=list)  # known poses and focal length of each call

    def labels(self, poses=None, camera=None):
        known = None if poses is None else sum(pose is not None for pose in poses)
        self.calls.append((known, None if camera is None else camera.focal))
        labels = np.zeros(SHAPE, np.uint8)
        labels[:, : round(self.shares[len(self.calls) - 1] * SHAPE[1])] = 1
        yield from [labels] * COUNT


@pytest.fixture
def frames(tmp_path):
    for name in ("cache", "frames"):
        (tmp_path / name).mkdir()
    prepared = PreparedFrames(Camera(focal=60.0), tmp_path / "cache", tmp_path / "frames")
    for k in range(COUNT):
        image = np.full(SHAPE, 100, np.uint8)
        prepared.add(SourceFrame(index=k, name=str(k), time=None, image=image, labels=None))
    return prepared


# Of each case: frames with positions in the paths that are found, one after the other; shares of
# the labels; for each check, whether it agrees; index of the path that is used; share of its labels
CASES = {
    "the path of static pixels agrees": ([3, 3], [FEW_LABELS], [True, True], 1, FEW_LABELS),
    "nothing moves": ([3], [NO_LABELS], [True], 0, NO_LABELS),
    "only the first path agrees": ([3, 3], [FEW_LABELS], [True, False, True], 0, FEW_LABELS),
    "labels leave no path that agrees": ([3, 3], [FEW_LABELS], [True, False, False], 0, NO_LABELS),
    "labels make the path shorter": ([3, 2], [FEW_LABELS], [True, True], 0, FEW_LABELS),
    "labels leave no path": ([3, 0], [FEW_LABELS], [True, False], 0, NO_LABELS),
    "most is labelled": ([3], [MOST_LABELS], [True], 0, NO_LABELS),
    "a longer path": ([3, 4, 4], [FEW_LABELS, OTHER_LABELS], [True] * 3, 2, OTHER_LABELS),
    "a longer path, whose labels are wrong": (
        [3, 4, 4], [FEW_LABELS, OTHER_LABELS], [True, True, False, True], 1, OTHER_LABELS
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_labels_and_path_begin_with_all_pixels(frames, case):
    positions, shares, answers, used, share = case
    paths = [path_of(count, 50.0 + k) for k, count in enumerate(positions)]
    search, found, judged, cameras = Labels(shares), iter(paths), iter(answers), []
    path = find_static_path(
        frames, search, lambda _: next(found), cameras.append, lambda _: next(judged)
    )
    assert path is paths[used] and cameras == [path]
    assert not list(found) and not list(judged)  # every path and every answer was asked for
    assert (frames.labels(0) > 0).mean() == pytest.approx(share, abs=0.02)
    # Labels are found with the path before them.
    assert search.calls == [(positions[k], 50.0 + k) for k in range(len(shares))]


def test_known_path_of_all_pixels_is_not_found_again(frames):
    plain, static = path_of(3), path_of(3)
    paths = iter([static])
    path = find_static_path(
        frames, Labels([FEW_LABELS]), lambda _: next(paths), lambda _: None, lambda _: True, plain
    )
    assert path is static


# The path of all pixels is contradicted: the first labels have no path, the second ones do.
@pytest.mark.parametrize(
    ("last", "answers", "used"),
    [
        (3, [False, True], 2),
        (3, [False, False, True], 0),  # the labels mend it
        (3, [False, False, False], 2),
        (2, [False, True], 0),
        (2, [False, False], 2),
    ],
)
def test_contradicted_path_of_all_pixels(frames, last, answers, used):
    paths = [path_of(3, 50.0), path_of(2, 51.0), path_of(last, 52.0)]
    search, found, judged = Labels([FEW_LABELS, OTHER_LABELS]), iter(paths), iter(answers)
    path = find_static_path(
        frames, search, lambda _: next(found), lambda _: None, lambda _: next(judged)
    )
    assert path is paths[used] and list(judged) == []
    assert search.calls == [(None, None), (2, 51.0)]


@pytest.mark.parametrize("readout", [0.0, 0.5])
def test_stated_readout_needs_no_path_of_all_pixels(frames, readout):
    frames.camera = replace(frames.camera, readout=readout)
    search, calls = Labels([FEW_LABELS, FEW_LABELS]), []

    def find(calibrate):
        calls.append(calibrate)
        return path_of(3)

    find_static_path(frames, search, find, lambda _: None, lambda _: True)
    assert search.calls[0] == ((None, None) if readout else (3, 50.0))
    assert len(calls) == (1 if readout else 2)


@pytest.mark.parametrize(("factor", "is_kept"), [(1.01, True), (1.03, False)])
def test_evidence_of_pairs_is_kept_for_a_similar_focal_length(factor, is_kept):
    film = bodies_film(bodies_path(3), 48, 64)
    search = SequenceLabels(film.camera)
    for frame in film.frames:
        search.add(frame)
    list(search.labels())
    known = search._pair_evidence
    other = replace(film.camera, focal=factor * film.camera.focal)
    list(search.labels(list(film.poses), other))
    assert (search._pair_evidence is known) == is_kept
