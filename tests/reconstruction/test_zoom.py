"""A zoom, or a distortion, that the camera does not state."""

import itertools
import json
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import tisfm
from tests.reconstruction.bundles import FOCAL, bundle
from tisfm.grade import Grade, GradeSummary
from tisfm.metrics import absolute_errors
from tisfm.reconstruction import pipeline
from tisfm.reconstruction.calibration.bundle_residuals import COMMON
from tisfm.reconstruction.calibration.camera_adjustment import (
    adjust_camera,
)
from tisfm.reconstruction.calibration.source_camera import add_radial
from tisfm.reconstruction.calibration.track_bundle import TrackBundle
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.rival import Rival
from tisfm.reconstruction.mapping.solution import FocalEstimate, Piece
from tisfm.reconstruction.path import camera_revision, path_bundle
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path.hidden_zoom import (
    CameraComparison,
    find_hidden_zoom,
    object_to_hidden_zoom,
)
from tisfm.reconstruction.path.path_bundle import choose_largest_piece
from tisfm.reconstruction.path.path_solver import PathSolver
from tisfm.reconstruction.path.settings import REVISION
from tisfm.reconstruction.result.calibration import Calibration
from tisfm.reconstruction.result.path_check import UNCHECKED, PathCheck
from tisfm.reconstruction.result.statuses import ONLY_TURNS, mark_contradicted, mark_doubtful
from tisfm.reconstruction.result.summary import summarise
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks
from tisfm.resampling import ZoomRemoval
from tisfm.scenes import room_film
from tisfm.sources.frame_reader import SourceFrame
from tisfm.status import Status

FAST = tisfm.Settings.preset("fast", motion="camera")
SHAPE = (180, 240)


def path_of(*pieces):
    return CameraPath(pieces=pieces, missing={}, observations=(), camera=tisfm.Camera(focal=FOCAL))


def piece_of(frames, *, only_turns=False):
    poses = {frame: np.eye(4) for frame in frames}
    views = () if only_turns else tuple(frames)
    return Piece(poses=poses, views=views, points={}, only_turns=only_turns)


def test_camera_is_revised_in_the_largest_piece_with_positions():
    pan, walk = piece_of(range(12), only_turns=True), piece_of(range(12, 20))
    assert choose_largest_piece(path_of(pan, walk)) is walk


@pytest.mark.parametrize(
    ("changes", "pieces", "zoom"),
    [
        ([0.1, 0.01], [piece_of(range(8))], 0.1),
        ([0.2, -0.1, 0.05, 0.01], [piece_of(range(8))], 0.15),
        ([0.2, -0.1, 0.05, -0.02], [piece_of(range(8))], None),  # the rounds do not converge
        ([0.1, 0.01], [piece_of(range(4)), piece_of(range(4, 8))], None),
        ([0.1, 0.01], [piece_of(range(4), only_turns=True), piece_of(range(4, 8))], 0.1),
    ],
)
def test_zoom_is_kept_if_it_converges_in_one_piece(monkeypatch, changes, pieces, zoom):
    found, _ = solve_zoom(monkeypatch, path_of(*pieces), changes)
    assert (found is None) == (zoom is None)
    if found is not None:
        assert found.path.zoom[-1] == pytest.approx(np.exp(zoom)) and found.path.zoom[0] == 1


@pytest.mark.parametrize(
    ("cost", "deviation", "options", "solves"),
    [
        (0.9, 0.01, {}, 1),
        (0.96, 0.01, {}, 1),  # a weak zoom
        (0.98, 0.01, {}, 0),  # a rolling shutter, not a zoom
        (0.9, 0.1, {}, 0),  # a forward motion looks like a zoom
        (0.9, 0.01, {"is_focal_known": False}, 0),  # a guess
        (0.98, 0.1, {"is_focal_known": False, "calibrate": "focal"}, 1),  # a bent first path
    ],
)
def test_path_is_solved_without_a_zoom_only_if_one_fits(
    monkeypatch, cost, deviation, options, solves
):
    path = path_of(piece_of(range(8)))
    found, count = solve_zoom(
        monkeypatch, path, [0.1, 0.01], cost=cost, deviation=deviation, **options
    )
    assert count == solves and (found is not None) == bool(solves)


def test_only_the_first_path_decides_whether_a_zoom_is_removed(monkeypatch):
    costs = iter([0.9, 0.99, 0.99])  # the tracks of later paths have no zoom any more
    found, count = solve_zoom(
        monkeypatch, path_of(piece_of(range(8))), [0.2, 0.1, 0.01], cost=costs
    )
    assert found is not None and count == 2


def solve_zoom(monkeypatch, path, changes, *, cost=0.5, deviation=0.01, **options):
    """Return the zoomed path, and how often it was solved; each round finds one of the changes."""
    costs = itertools.repeat(cost) if isinstance(cost, float) else cost
    remaining, solved = iter(changes), []
    adjusted = SimpleNamespace(zoom_deviation=np.array([deviation]))
    for name, answer in (
        ("_find_remaining_zoom", lambda *_: (adjusted, next(remaining) * (np.arange(8) > 4))),
        ("adjust_largest_piece", lambda *_: None),
        ("compare_costs", lambda *_: next(costs)),
        ("unzoom_tracks", lambda tracks, *_: tracks),
    ):
        monkeypatch.setattr(camera_revision, name, answer)
    monkeypatch.setattr(PathSolver, "solve", lambda *_: solved.append(path) or path)
    tracks = SequenceTracks(
        observations=[None] * 8, views=(), matches={}, shape=SHAPE, distinct_count=8
    )
    solver = PathSolver(tracks=tracks, camera=path.camera, **options)
    return camera_revision._solve_zoom(path, solver, np.arange(8), ()), len(solved)


@pytest.mark.parametrize(
    ("zoom", "lens", "needed"),
    [
        (np.zeros(8), (0.0, 0.0, 0.0, 0.0), False),
        (0.005 * np.arange(8), (0.0, 0.0, 0.0, 0.0), True),
        (np.zeros(8), (-0.1, 0.0, 0.0, 0.0), True),
    ],
)
def test_constant_focal_length_needs_no_richer_camera(monkeypatch, zoom, lens, needed):
    monkeypatch.setattr(camera_revision, "make_bundle", lambda *_: bundle(zoom, lens))
    path = path_of(piece_of(range(8)))
    (window,) = camera_revision.compare_cameras(path, (), SHAPE)
    assert (window.rich.cost < REVISION.max_cost * window.base.cost) == needed


@pytest.mark.parametrize(
    ("views", "frames"),
    [
        ([0, 7, 15], [0, 2, 4, 6, 7, 9, 11, 13, 15]),
        ([0, 5, 10, 15], [0, 5, 10, 15]),
    ],
)
def test_frames_join_few_views(views, frames):
    piece = replace(piece_of(range(16)), views=tuple(views))
    assert path_bundle.choose_frames(path_of(piece)) == list(frames)


@pytest.mark.parametrize("rate", [0.0, 0.02])
def test_zoom_along_a_forward_motion_is_an_objection(rate):
    frames = range(12)
    random = np.random.default_rng(0)
    points = np.column_stack([random.uniform(-4, 4, 200), random.uniform(-2, 2, 200),
                              random.uniform(8, 40, 200)])  # fmt: skip
    poses = np.array([np.c_[np.eye(3), (0, 0, -0.4 * k)] for k in frames])
    views, indices = (grid.ravel() for grid in np.mgrid[: len(poses), : len(points)])
    local = points[indices] + poses[views, :, 3]
    positions = FOCAL * np.exp(rate * views)[:, None] * local[:, :2] / local[:, 2:]
    drive = TrackBundle(
        frames=tuple(frames), tracks=np.arange(200), poses=poses, points=points, views=views,
        indices=indices, positions=positions + random.normal(0, 0.05, positions.shape),
    )  # fmt: skip
    base = adjust_camera(drive, FOCAL)
    rich = adjust_camera(base.bundle, FOCAL, COMMON, has_zoom=True, scales=(0.5,))
    comparison = CameraComparison(base=base, rich=rich)
    found = find_hidden_zoom([comparison], ())
    assert np.sign(found) == np.sign(rate)
    objection = object_to_hidden_zoom(found)
    assert bool(objection) == bool(rate) == ("check the focal length and the lens" in objection)


@pytest.mark.parametrize(
    ("zoom", "focal", "options", "deviation", "cost", "shown"),
    [
        (0.02, None, {}, 0.001, 0.5, True),
        (0.02, None, {}, 0.001, 0.96, False),  # a constant focal length fits as well
        (0.02, None, {}, 0.05, 0.5, False),  # inexact
        (0.0, None, {}, 0.001, 0.5, False),  # a constant focal length
        (0.02, 1.0, {"calibrate": "focal"}, 0.001, 0.5, True),  # estimated to 0.5 %
        (0.02, 100.0, {"calibrate": "focal"}, 0.001, 0.5, False),  # to 50 %
        (0.02, None, {"camera": tisfm.Camera(focal=1.3 * FOCAL)}, 0.001, 0.5, False),  # too long
    ],
)
def test_zoom_is_shown_with_a_focal_length_that_is_known(
    monkeypatch, zoom, focal, options, deviation, cost, shown
):
    monkeypatch.setattr(camera_revision, "compare_costs", lambda *_: cost)
    zooms = zoom * np.arange(8)
    path = path_of(piece_of(range(8)))
    tracks = SequenceTracks(
        observations=[None] * 8, views=(), matches={}, shape=SHAPE, distinct_count=8
    )
    solver = PathSolver(**{"tracks": tracks, "camera": path.camera, **options})
    estimate = None if focal is None else FocalEstimate(focal=FOCAL, deviation=focal)
    zoomed_path = camera_revision._ZoomedPath(
        path=replace(path, zoom=np.exp(zooms), focal=estimate),
        adjusted=replace(
            adjust_camera(bundle(zooms), solver.camera.focal, has_zoom=True),
            zoom_deviation=np.full(8, deviation),
        ),
        constant=adjust_camera(bundle(zooms), FOCAL, ("focal", "k1")),
    )
    assert camera_revision._shows_zoom(path, zoomed_path, solver) == shown


@pytest.mark.parametrize(
    ("options", "revised"),
    [
        ({}, True),
        ({"camera": tisfm.Camera(focal=FOCAL)}, True),
        ({"calibrate": "nothing"}, False),
        ({"calibrate": "focal"}, False),
        ({"poses": np.tile(np.eye(4), (2, 1, 1))}, False),
        ({"settings": tisfm.Settings.preset("fast", motion="objects")}, False),
    ],
)
def test_camera_is_revised_unless_it_is_stated_what_to_find(monkeypatch, options, revised):
    jobs = []

    def reconstruct_sequence(job):
        jobs.append(job)
        raise InterruptedError

    monkeypatch.setattr(pipeline, "reconstruct_sequence", reconstruct_sequence)
    with pytest.raises(InterruptedError):
        tisfm.reconstruct(np.zeros((2, 60, 80), np.uint8), **options)
    assert jobs[0].revises_camera == revised


def test_mask_has_the_fixed_pixels_that_all_corrected_frames_ignore(tmp_path):
    for name in ("cache", "frames"):
        (tmp_path / name).mkdir()
    frames = PreparedFrames(tisfm.Camera(focal=80.0), tmp_path / "cache", tmp_path / "frames")
    picture = np.random.default_rng(0).integers(0, 255, (60, 80), np.uint8)
    for k in range(3):
        frames.add(SourceFrame(index=k, name=str(k), time=None, image=picture))
    band = np.zeros((60, 80), bool)
    band[44:52] = True
    frames.ignore(band)
    mask = frames.correct(frames.camera, None, np.array([1.0, 1.1, 1.2]), band)
    ignored = np.array([frames.ignored(k) for k in range(3)])
    # the band of the first frame, where that of the last one or the border lies as well
    assert mask.any() and (mask <= band).all() and not np.array_equal(mask, band)
    np.testing.assert_array_equal(mask, ignored.all(axis=0))
    assert frames.correct(frames.camera) is None


@pytest.mark.parametrize("origin", ["given", "estimated"])
def test_summary_states_the_zoom(origin):
    message = "200 px; the camera zooms: …" if origin == "given" else "200 ± 2 px, estimated"
    text = summarise(
        np.zeros(3, np.int32),
        np.ones(3, bool),
        [Status("converged")] * 3,
        GradeSummary.of([Grade.GOOD] * 3, [0.01] * 3),
        tisfm.Camera(focal=FOCAL),
        Calibration(origin=origin, focal=FOCAL, focal_std=2.0, message=message),
        np.array([1.0, 1.1, 1.2]),
    )
    assert text.count("the camera zooms") == 1


def test_zoom_is_removed_about_the_principal_point():
    y, x = np.mgrid[:60, :80].astype(np.float32)
    image = 2 * x + y
    removal = ZoomRemoval(1.25, (40.0, 20.0), (60, 80))
    expected = 2 * (40 + 1.25 * (x - 40)) + 20 + 1.25 * (y - 20)
    inner = cv2.erode(removal.valid.astype(np.uint8), np.ones((21, 21))) > 0  # off the border
    assert np.abs(removal.apply(image) - expected)[inner].max() < 1e-3
    assert removal.valid[20, 40]
    assert not removal.valid[0, 0]


@pytest.fixture(scope="module")
def film():
    """A room, with 12 poses."""
    path, pose = [], np.eye(4)
    for k in range(12):
        path.append(pose)
        turn = 0.01 * np.sin([0.7 * k, 0.45 * k + 1, 0.9 * k])
        pose = pose @ tisfm.rigid.pose_matrix(
            [0.08, 0.013, 0.02, *(turn + np.array([0, 0.008, 0]))]
        )
    return room_film(np.array(path), 180, 240, samples=1)


def zoomed(frames, zoom):
    """Return frames magnified about their centre."""
    height, width = frames[0].shape
    return [
        cv2.warpAffine(
            np.asarray(frame),
            np.float32([[s, 0, (1 - s) * (width - 1) / 2], [0, s, (1 - s) * (height - 1) / 2]]),
            (width, height),
            flags=cv2.INTER_CUBIC,
        )
        for frame, s in zip(frames, zoom, strict=True)
    ]


def test_film_with_zoom_gets_a_focal_length_for_each_frame(film, tmp_path):
    zoom = 1.012 ** np.arange(12)
    frames = zoomed(film.frames, zoom)
    result = tisfm.reconstruct(frames, camera=film.camera, settings=FAST, depth_of="none")
    assert set(map(str, result.status)) == {"converged"}
    assert np.abs(result.focal / (film.camera.focal * zoom) - 1).max() < 0.03
    assert result.camera.focal == film.camera.focal == result.focal[0]
    assert absolute_errors(result.poses, film.poses).similarity < 0.02
    assert "the camera zooms" in result.calibration.message
    assert "the camera zooms" in result.summary()
    result.save(tmp_path / "copy")
    loaded = tisfm.Reconstruction.load(tmp_path / "copy")
    assert np.array_equal(loaded.focal, result.focal)
    record = json.loads((tmp_path / "copy" / "reconstruction.json").read_bytes())
    record["zoom"][3] = 0
    (tmp_path / "copy" / "reconstruction.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match="zoom has a number that is not positive"):
        tisfm.Reconstruction.load(tmp_path / "copy")


@pytest.mark.nightly
def test_zoom_of_frames_that_are_cropped_and_shrunk(film):
    """The focal length of each frame has the unit of the frames of the source."""
    zoom = 1.012 ** np.arange(12)
    frames = [np.pad(frame, ((8, 8), (10, 10))) for frame in zoomed(film.frames, zoom)]
    result = tisfm.reconstruct(
        frames, camera=film.camera, settings=FAST, depth_of="none", crop=(10, 8, 240, 180), size=200
    )
    assert np.abs(result.focal / (film.camera.focal * zoom) - 1).max() < 0.03
    assert result.shape == (150, 200)
    assert result.camera.focal == pytest.approx(film.camera.focal * 200 / 240)


@pytest.mark.nightly
def test_camera_stays_as_given_with_calibrate_nothing(film):
    frames = zoomed(film.frames, 1.012 ** np.arange(12))
    result = tisfm.reconstruct(
        frames, camera=film.camera, calibrate="nothing", settings=FAST, depth_of="none"
    )
    assert result.zoom is None
    assert (result.focal == film.camera.focal).all()
    assert result.status[0] == "contradicted"


@pytest.mark.nightly
def test_constant_focal_length_stays_constant(film):
    default, fixed = (
        tisfm.reconstruct(
            film.frames, camera=film.camera, settings=FAST, depth_of="none", **options
        )
        for options in ({}, {"calibrate": "nothing"})
    )
    assert default.zoom is None
    assert np.array_equal(default.poses, fixed.poses)
    assert default.calibration.message == ""


@pytest.mark.nightly
def test_distortion_that_is_not_stated_is_found(film):
    # r = r_u (1 + k1 r_u²): the strong barrel of a wide lens. It shows more than a pinhole, so the
    # frames are cut out of a larger film.
    height, width = film.frames[0].shape
    wide = room_film(film.poses, 260, 340, focal=film.camera.focal, samples=1)
    matrix = np.diag([film.camera.focal, film.camera.focal, 1.0])
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    straight = cv2.undistortPoints(
        (pixels - [(width - 1) / 2, (height - 1) / 2]).reshape(-1, 1, 2),
        matrix, np.array([-0.2, 0, 0, 0]), P=matrix,
    ).reshape(height, width, 2)  # fmt: skip
    u, v = np.moveaxis((straight + np.array([169.5, 129.5])).astype(np.float32), -1, 0)
    frames = [cv2.remap(np.asarray(frame), u, v, cv2.INTER_CUBIC) for frame in wide.frames]
    result = tisfm.reconstruct(frames, camera=film.camera, settings=FAST, depth_of="none")
    assert set(map(str, result.status)) == {"converged"}
    assert result.calibration.radial == pytest.approx(-0.2, abs=0.04)
    assert 0 < result.calibration.radial_std < 0.02
    assert result.camera.focal == film.camera.focal
    assert absolute_errors(result.poses, film.poses).similarity < 0.02
    assert "the lens distorts: k1 =" in result.summary()


def test_objection_to_the_camera_contradicts_all_frames_with_a_pose():
    statuses = [Status("converged"), Status("no_pose", "few tracks"), Status("converged")]
    check = PathCheck(pairs=(), fixed_share=0.0, infinity_motion=0.0)
    marked = mark_contradicted(statuses, [0, -1, 0], [check], objection="another focal length fits")
    assert list(map(str, marked)) == ["contradicted", "no_pose", "contradicted"]
    assert marked[0].message == "another focal length fits"
    assert mark_contradicted(statuses, [0, -1, 0], [check]) == tuple(statuses)


def test_objection_to_the_camera_leaves_a_turning_piece_without_positions():
    statuses = [Status("converged"), ONLY_TURNS]
    walk, pan = mark_contradicted(statuses, [0, 1], [UNCHECKED] * 2, objection="a zoom fits")
    assert walk == "contradicted" and pan == "pure_rotation"
    assert pan.message == f"{ONLY_TURNS.message}; a zoom fits"


def test_coefficient_of_a_stated_focal_length_is_said():
    given = Calibration(origin="given", focal=200.0, shape=(180, 240))
    estimate = FocalEstimate(focal=200.0, deviation=0.0, radial=-0.2, radial_deviation=0.004)
    said = add_radial(given, estimate)
    assert (said.radial, said.radial_std, said.focal) == (-0.2, 0.004, 200.0)
    assert "k1 = -0.200 ± 0.004, estimated from the sequence and removed" in said.message


def test_doubt_makes_converged_frames_of_its_piece_uncertain():
    statuses = [Status("converged"), Status("contradicted", "no"), Status("converged"), ONLY_TURNS]
    marked = mark_doubtful(statuses, [0, 0, 1, 0], ["perhaps a zoom", ""])
    assert list(map(str, marked)) == ["uncertain", "contradicted", "converged", "pure_rotation"]
    assert marked[0].message == "perhaps a zoom"


def test_piece_names_its_rival_and_the_doubt_of_the_camera():
    rival = Rival(loss=1.0, direction=40.0, rotation=2.0)
    pieces = (replace(piece_of(range(4)), rival=rival), piece_of(range(4, 8)))
    path = replace(path_of(*pieces), doubt="perhaps a zoom")
    first, second = path.doubts
    assert "differ by 40°" in first and first.endswith("; perhaps a zoom")
    assert second == "perhaps a zoom"


@pytest.mark.parametrize("deviation", [0.0, 0.2])
def test_hidden_zoom_is_a_doubt_if_the_focal_length_is_a_guess(monkeypatch, deviation):
    monkeypatch.setattr(camera_revision, "compare_cameras", lambda *_: [])
    monkeypatch.setattr(camera_revision, "find_hidden_zoom", lambda *_: 0.01)
    monkeypatch.setattr(camera_revision, "_fits_badly", lambda *_: False)
    focal = FocalEstimate(focal=FOCAL, deviation=deviation * FOCAL)
    path = replace(path_of(piece_of(range(8))), focal=focal)
    solver = PathSolver(tracks=SimpleNamespace(shape=SHAPE), camera=path.camera, calibrate="focal")
    revised = camera_revision.revise_path(path, solver, np.arange(8), may_distort=True)
    assert bool(revised.doubt) == bool(deviation) and bool(revised.objection) != bool(deviation)
