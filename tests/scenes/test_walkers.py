"""The film with walkers: its truth, and its options."""

import numpy as np
import pytest

from tisfm.scenes import bodies_path, walkers_film

SIZE = 120, 160
GROUND = 1.5  # m below the camera of frame 0


@pytest.fixture(scope="module")
def film():
    return walkers_film(bodies_path(8), *SIZE, samples=1)


def points_of(film, number):
    """Return what each pixel of a frame sees, in the world, (3, H, W)."""
    cy, cx = (side / 2 - 0.5 for side in SIZE)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    rays = np.stack([(x - cx) / film.camera.focal, (y - cy) / film.camera.focal, np.ones(x.shape)])
    pose = film.poses[number]
    return np.tensordot(pose[:3, :3], rays * film.depth[number], 1) + pose[:3, 3, None, None]


@pytest.mark.parametrize("walker", [1, 2])
def test_walkers_stand_on_the_ground_at_their_positions(film, walker):
    for number in (0, 7):
        points = points_of(film, number)[:, film.labels[number] == walker]
        position = film.positions[walker - 1, number]
        height = GROUND - points[1].min()
        assert points[1].max() <= GROUND + 1e-6 and 1.55 < height < 1.9
        assert np.abs(points[[0, 2]] - position[[0, 2], None]).max() < 0.8
    # The nearer foot of the first walker is seen down to the ground.
    if walker == 1:
        assert points[1].max() > GROUND - 0.05


def test_walkers_are_not_rigid(film):
    """The outline of a walker in the frame, relative to its box, changes within a stride."""
    outlines = []
    for number in (0, 7):
        columns = np.nonzero(film.labels[number] == 1)[1]
        outlines.append(columns.max() - columns.min())
    assert abs(outlines[1] - outlines[0]) > 4


def test_walkers_can_be_left_out():
    none, one = (walkers_film(bodies_path(2), *SIZE, walkers=count, noise=0) for count in (0, 1))
    assert not none.labels.any() and none.positions.shape == (0, 2, 3)
    at_rest = one.labels == 0
    assert set(np.unique(one.labels)) == {0, 1}
    np.testing.assert_array_equal(none.depth[at_rest], one.depth[at_rest])
    assert (one.depth <= none.depth + 1e-6).all()
    with pytest.raises(ValueError, match="walkers is 3: expected 2 at most"):
        walkers_film(bodies_path(2), *SIZE, walkers=3)
