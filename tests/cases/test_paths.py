"""Paths of cameras before planes, of cameras that only turn, and of a page that scrolls."""

from functools import cache

import cv2
import numpy as np
import pytest

import tisfm
import tisfm.focal_guess
from tests.cases import inputs
from tests.draws import nightly_except
from tests.reconstruction.films import path_error
from tisfm.rigid import pose_matrix

HEIGHT, WIDTH, FOCAL, COUNT = 180, 240, 240.0, 10
DISTANCE = 10.0  # m, from the first camera to the plane along its axis
PX_PER_M = 45  # of the texture


@cache
def texture(seed=3, size=1536):
    """Return a texture with structure at all scales, (size, size) float32."""
    random, total = np.random.default_rng(seed), np.zeros((size, size), np.float32)
    for deviation, contrast in ((1.5, 20), (4, 25), (12, 30), (40, 25)):
        noise = random.normal(0, 1, (size, size)).astype(np.float32)
        blurred = cv2.GaussianBlur(noise, (0, 0), deviation)
        total += contrast * blurred / blurred.std()
    return total + 120


def plane_film(poses, normal=(0, 0, 1), relief=0.0):
    """Return frames of a plane with boxes on it, (N, H, W) uint8.

    Parameters
    ----------
    poses : (N, 4, 4) array
        Camera to world, m.
    normal : (float, float, float)
        Of the plane.
    relief : float
        Height of the boxes over the distance of the plane.
    """
    random = np.random.default_rng(1)
    corners = random.uniform(-5, 4, (12, 2)) if relief else np.empty((0, 2))
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    centre = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    ray = np.dstack([(columns - centre[0]) / FOCAL, (rows - centre[1]) / FOCAL, 1 + 0 * rows])
    frames = []
    for pose in poses:
        world, origin = ray @ pose[:3, :3].T, pose[:3, 3]
        point = (
            origin
            + ((np.array([0, 0, DISTANCE]) - origin) @ normal / (world @ normal))[..., None] * world
        )
        top = (1 - relief) * DISTANCE
        on_top = origin + ((top - origin[2]) / world[..., 2])[..., None] * world
        for x, y in corners:
            box = (abs(on_top[..., 0] - x) < 0.6) & (abs(on_top[..., 1] - y) < 0.6)
            point = np.where(box[..., None], on_top, point)
        places = (PX_PER_M * point[..., :2] + len(texture()) / 2).astype(np.float32)
        frame = cv2.remap(
            texture(), places[..., 0], places[..., 1], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT,
        )  # fmt: skip
        frames.append(np.clip(np.rint(frame), 0, 255).astype(np.uint8))
    return np.array(frames)


def flight(velocity, wobble=0.0):
    """Return poses of a camera that flies straight, and maybe shakes, camera to world."""
    at = np.arange(COUNT)
    turns = wobble * np.stack([np.sin(0.7 * at), np.cos(0.9 * at) - 1, np.sin(0.4 * at)], axis=1)
    twists = np.hstack([np.outer(at, velocity), turns])
    return np.array([pose_matrix(twist) for twist in twists])


def path_of(frames, focal=FOCAL):
    return tisfm.reconstruct(
        frames,
        camera=None if focal is None else tisfm.Camera(focal=focal),
        settings=tisfm.Settings.preset("fast", motion="camera"),
        depth_of="none",
    )


ABOVE = (0, -0.35, 0)  # m/frame, as a drone that looks down


@pytest.mark.parametrize(
    ("poses", "scene"),
    [
        (flight(ABOVE), {}),
        pytest.param(flight(ABOVE, 0.02), {}, marks=pytest.mark.nightly),
        pytest.param(
            flight((0.3, 0, 0.12), 0.01), {"normal": (0.5, 0, 0.866)}, marks=pytest.mark.nightly
        ),
        pytest.param(flight(ABOVE), {"relief": 0.02}, marks=pytest.mark.nightly),
        pytest.param(flight(ABOVE), {"relief": 0.05}, marks=pytest.mark.nightly),
        pytest.param(flight(ABOVE), {"relief": 0.1}, marks=pytest.mark.nightly),
    ],
    ids=["flat", "wobbling", "slanted", "relief 2 %", "relief 5 %", "relief 10 %"],
)
def test_plane_gives_a_path_where_the_focal_length_is_stated(poses, scene):
    found = path_of(plane_film(poses, **scene))
    assert (found.piece == 0).all()
    assert set(found.status) == {"converged"}
    assert path_error(found.poses, poses) < 0.0005
    assert found.calibration.readout == 0  # an even flight shows none


def test_plane_and_a_guessed_focal_length_give_no_path():
    with pytest.warns(tisfm.focal_guess.GuessedFocalWarning):
        found = path_of(plane_film(flight(ABOVE)), focal=None)
    assert (found.piece == -1).all()
    assert set(found.status) == {"one_plane"}
    assert "one plane" in found.status[0].message
    assert "Give the focal length" in found.status[0].message


@pytest.mark.parametrize("stated", nightly_except(1.0, of=[1.0, 0.7, 1.5]))
def test_camera_that_only_turns_gives_no_path_for_any_focal_length(stated):
    poses = np.array([pose_matrix((0, 0, 0, 0, 0.025 * k, 0.004 * k)) for k in range(COUNT)])
    films = tisfm.scenes.room_film(poses, 120, 160, samples=1)
    found = path_of(films.frames, focal=stated * films.camera.focal)
    assert (np.nan_to_num(found.poses[:, :3, 3]) == 0).all()
    # With a wrong focal length, no rotation explains the frames.
    assert set(found.status) == {"pure_rotation" if stated == 1 else "little_parallax"}


def page(height=700):
    """Return a page of text, (height, WIDTH) uint8."""
    random, paper = np.random.default_rng(2), np.full((height, WIDTH), 255, np.uint8)
    for line in range(16, height, 15):
        letters = "".join(random.choice(list("abcdefghijklmnopqrstuvwxyz    "), 30))
        cv2.putText(paper, letters, (4, line), cv2.FONT_HERSHEY_PLAIN, 0.9, 30, 1)
    return paper


@pytest.mark.filterwarnings("ignore::tisfm.focal_guess.GuessedFocalWarning")
@pytest.mark.parametrize("focal", nightly_except(None, of=[None, FOCAL]))
def test_page_that_scrolls_shows_no_readout(focal):
    found = path_of([page()[9 * k : 9 * k + HEIGHT] for k in range(COUNT)], focal=focal)
    assert found.calibration.readout == 0


def test_room_gives_an_exact_path():
    found = path_of(inputs.room(10, 120, 160), focal=96.0)
    assert (found.piece == 0).all()
    assert path_error(found.poses, inputs.walk(10)) < 0.012  # measured: 0.0083
    assert found.calibration.readout == 0


@pytest.mark.nightly
def test_guessed_focal_length_is_not_treated_as_known():
    with pytest.warns(tisfm.focal_guess.GuessedFocalWarning):
        found = tisfm.reconstruct(
            plane_film(flight(ABOVE)),
            calibrate="nothing",
            settings=tisfm.Settings.preset("fast", motion="camera"),
            depth_of="none",
        )
    assert set(found.status) == {"one_plane"}
    assert "one plane" in found.status[0].message
