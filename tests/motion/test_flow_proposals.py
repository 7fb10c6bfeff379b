"""Motions that coarse-to-fine solution loses: large motions, and fast small objects."""

import hashlib

import cv2
import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.pairwise import pairwise
from tests.rendered import static_scene, two_blocks
from tisfm.formats import read_image
from tisfm.formats.float_maps import read_flo
from tisfm.motion import field
from tisfm.scenes import static_scene as rendered

MARGIN = 200
PRESETS = ("fast", "balanced", "accurate")


def texture(height, width, seed):
    """Return noise of three scales, mean 128."""
    rng = np.random.default_rng(seed)
    octaves = [
        cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), sigma) for sigma in (1.2, 4, 14)
    ]
    return 128 + 18.5 * sum(octave / octave.std() for octave in octaves)


def seen(surface, matrix, height, width):
    """Return a surface sampled at the pixels of a frame, moved by a 2×3 matrix, uint8."""
    matrix = np.add(matrix, [[0, 0, MARGIN], [0, 0, MARGIN]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    frame = cv2.warpAffine(surface, matrix, (width, height), flags=flags)
    return np.clip(np.rint(frame), 0, 255).astype(np.uint8)


def moved(matrix, height=240, width=400, seed=0):
    """Return two frames of a surface under an affine motion, its flow, and the pixels that stay."""
    surface = texture(height + 2 * MARGIN, width + 2 * MARGIN, seed)
    matrix = np.array(matrix, float)
    rows, columns = np.mgrid[:height, :width]
    flow = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ matrix.T
    stays = ((flow >= 0) & (flow <= [width - 1, height - 1])).all(axis=-1)
    flow -= np.stack([columns, rows], axis=-1)
    frame0 = seen(surface, np.eye(2, 3), height, width)
    frame1 = seen(surface, cv2.invertAffineTransform(matrix), height, width)
    return frame0, frame1, flow, stays


def with_object(background, move, size=30, seed=5):
    """Return frames with a square object that moves by whole px, the flow, and its mask."""
    frame0, frame1, flow, _ = background
    frame0, frame1, flow = frame0.copy(), frame1.copy(), flow.copy()
    height, width = frame0.shape
    paint = texture(size + 40, size + 40, seed)[20:-20, 20:-20].clip(0, 255)
    row, column = (height - size - move[1]) // 2, (width - size - move[0]) // 2
    frame0[row : row + size, column : column + size] = paint
    frame1[row + move[1] :, column + move[0] :][:size, :size] = paint
    body = np.zeros((height, width), bool)
    body[row : row + size, column : column + size] = True
    flow[body] = move
    return frame0, frame1, flow, body


def error(result, flow):
    return np.linalg.norm(result.flow - flow, axis=-1)


def without_proposals(monkeypatch, *frames, **options):
    with monkeypatch.context() as patch:
        patch.setattr(field, "flow_proposals", lambda pyramid, problem: None)
        return tisfm.interpret(*frames, **options)


AFAR = [[1.02, 0.1, 76], [0.01, 1.03, 10]]  # flow of 76 to 108 px


@pytest.mark.parametrize("preset", nightly_except("balanced", of=PRESETS))
def test_a_background_that_moves_by_100_px_is_found(preset):
    frame0, frame1, flow, stays = moved(AFAR)
    assert np.linalg.norm(flow, axis=-1).max() > 100
    result = tisfm.interpret(frame0, frame1, settings=tisfm.Settings.preset(preset))
    off = error(result, flow)
    assert off[stays].mean() < 1
    assert off.mean() < 5  # pixels that leave the image get the flow of those that stay


def test_right_flow_of_pixels_that_leave_the_image_is_kept(monkeypatch):
    frame0, frame1, flow, stays = moved([[1.3, 0, -59.9], [0, 1.3, -35.9]])
    assert stays.mean() < 0.65
    off = error(tisfm.interpret(frame0, frame1), flow).mean()
    assert off < 1.05 * error(without_proposals(monkeypatch, frame0, frame1), flow).mean()


@pairwise(preset=["balanced", "accurate"], drift=[0, 3], move=[(60, 0), (-42, 43)], short=True)
def test_a_small_object_that_moves_far_is_found(preset, drift, move):
    background = moved([[1, 0, drift], [0, 1, -drift / 2]], seed=drift)
    frame0, frame1, flow, body = with_object(background, move)
    result = tisfm.interpret(frame0, frame1, settings=tisfm.Settings.preset(preset))
    off = error(result, flow)
    assert off[body].mean() < 2
    assert np.median(off[~body]) < 0.1
    assert off[~body].mean() < 0.6


def test_without_proposals_both_are_lost(monkeypatch):
    frame0, frame1, flow, body = with_object(moved(np.eye(2, 3)), (60, 0))
    result = without_proposals(monkeypatch, frame0, frame1)
    assert error(result, flow)[body].mean() > 30
    frame0, frame1, flow, stays = moved(AFAR)
    result = without_proposals(monkeypatch, frame0, frame1)
    assert error(result, flow)[stays].mean() > 30


def bare(height=240, width=400, grey=110):
    """Return two frames of a wall without texture, at rest, its flow, and a mask of all pixels."""
    frame = np.full((height, width), grey, np.uint8)
    return frame, frame, np.zeros((height, width, 2)), np.ones((height, width), bool)


@pairwise(
    background=["textured", "half bare", "bare"],
    sized=[(60, (50, 0)), (60, (-30, 32)), (30, (-45, 40))],
    short=True,
)
def test_an_object_that_moves_by_about_its_size_is_found(monkeypatch, background, sized):
    size, move = sized
    ground = bare() if background == "bare" else moved(np.eye(2, 3))
    if background == "half bare":
        for frame in ground[:2]:
            frame[:, :200] = 110
    frame0, frame1, flow, body = with_object(ground, move, size=size)
    lost = without_proposals(monkeypatch, frame0, frame1)
    assert np.median(error(lost, flow)[body]) > 5
    off = error(tisfm.interpret(frame0, frame1), flow)
    assert np.median(off[body]) < 0.5
    assert off[body].mean() < 4  # the outline is inaccurate
    if background == "textured":
        assert off[~body].mean() < 0.6


def test_a_hot_pixel_makes_no_object(monkeypatch):
    frame0, frame1, flow, _ = moved([[1, 0, 1.5], [0, 1, -0.5]])
    for frame in (frame0, frame1):  # a defect of the sensor, which does not move
        frame[100, 150] = 255
        frame[60, 300] = 0
    amended = tisfm.interpret(frame0, frame1)
    np.testing.assert_array_equal(amended.rho, without_proposals(monkeypatch, frame0, frame1).rho)
    assert error(amended, flow).mean() < 0.2


def test_bare_frames_are_left_alone(monkeypatch):
    noise = np.random.default_rng(0).normal(0, 1.5, (2, 240, 400))
    frames = np.rint(110 + noise).astype(np.uint8)
    amended = tisfm.interpret(*frames)
    np.testing.assert_array_equal(amended.rho, without_proposals(monkeypatch, *frames).rho)
    frame0, frame1, _, _ = bare()
    assert np.abs(tisfm.interpret(frame0, frame1).flow).max() == 0


def test_a_half_bare_frame_is_left_alone(monkeypatch):
    frame0, frame1, flow, _ = moved([[1, 0, 1.5], [0, 1, -0.5]])
    frame0[:, :200], frame1[:, :200] = 110, 110
    amended = tisfm.interpret(frame0, frame1)
    np.testing.assert_array_equal(amended.rho, without_proposals(monkeypatch, frame0, frame1).rho)
    assert np.median(error(amended, flow)[:, 210:]) < 0.1


@pytest.mark.parametrize("scene", nightly_except("object", of=["object", "background"]))
def test_any_type_of_frames_gives_the_same_flow(scene):
    """Uint16 with the full range, uint16 with 12 bits, and float in [0, 1]."""
    if scene == "object":
        frame0, frame1, flow, judged = with_object(moved([[1, 0, 3], [0, 1, -1.5]]), (60, 0))
    else:
        frame0, frame1, flow, judged = moved(AFAR)
    expected = tisfm.interpret(frame0, frame1)
    assert np.median(error(expected, flow)[judged]) < 0.2
    for change in (
        lambda frame: frame.astype(np.uint16) * 257,
        lambda frame: frame.astype(np.uint16) * 16,
        lambda frame: frame / 255,
    ):
        result = tisfm.interpret(change(frame0), change(frame1))
        off = np.linalg.norm(result.flow - expected.flow, axis=-1)
        assert off[judged].mean() < 0.01
        assert off.mean() < 0.1


@pytest.mark.parametrize("kind", ["stripes", "bare", "too far", "texture"])
def test_ambiguous_areas_do_not_move(kind):
    """Stripes and bare areas match far away, and so does anything by chance in a whole image."""
    from tisfm.motion.fast_objects import distinctive_areas
    from tisfm.motion.matched_windows import Windows

    frame0 = texture(200, 300, 0).astype(np.float32)
    if kind == "stripes":
        frame0[:] = frame0[50]
    elif kind == "bare":
        frame0[:] = 110
    frame0 += np.random.default_rng(0).normal(0, 0.7, frame0.shape).astype(np.float32)
    new = np.zeros(frame0.shape, bool)
    new[140:170, 140:180] = True
    there, before = np.zeros((2, *frame0.shape, 4), np.float32)
    there[..., :2] = (-130, 0) if kind == "too far" else (8, -90)
    windows = Windows(grey0=frame0, grey1=frame0, noise=0.7, scale=1.0)
    kept = distinctive_areas(new, there, before, windows)
    np.testing.assert_array_equal(kept, new if kind == "texture" else np.zeros_like(new))


@pytest.mark.parametrize("preset", ["balanced", "accurate"])
@pytest.mark.parametrize("crop", [np.s_[100:340, 200:520]])
def test_a_smooth_corner_stays_near(shared_data, preset, crop):
    folder = shared_data / "middlebury" / "Urban2"
    frames = [read_image(folder / f"frame1{k}.png")[crop] for k in (0, 1)]
    truth = read_flo(folder / "flow10.flo")[crop]
    result = tisfm.interpret(*frames, settings=tisfm.Settings.preset(preset))
    assert result.status == "converged"
    assert np.linalg.norm(result.flow, axis=-1).max() < 40
    assert error(result, truth).mean() < 1


@pytest.mark.parametrize("share", [0.5, 0.55])
def test_a_shift_by_half_the_image_does_not_count_as_diverged(share):
    shift = round(share * 320)
    surface = np.clip(np.rint(texture(240, 320 + shift, 0)), 0, 255).astype(np.uint8)
    result = tisfm.interpret(surface[:, :320], surface[:, shift:])
    assert error(result, (-shift, 0))[:, shift:].mean() < 0.5
    assert result.status == "converged"


@pytest.mark.parametrize("kind", ["shifted", "unrelated", "repeating", "periods", "folded", "near"])
def test_images_confirm_a_shift_by_half_the_image_only_where_they_agree(kind):
    from tisfm.motion.frame_agreement import confirms_large_motion
    from tisfm.motion.problems import pyramid_of
    from tisfm.visibility.occlusion import leaves_image

    surface = texture(240, 480, 0).astype(np.float32)
    frame0, frame1 = surface[:, :320], surface[:, 160:]
    flow = np.zeros((2, 240, 320), np.float32)
    flow[0] = -160
    if kind == "unrelated":
        frame1 = texture(240, 320, 1).astype(np.float32)
    elif kind == "repeating":  # the shift is two and a half periods
        frame0 = frame1 = np.tile(surface[:, :64], 5)
    elif kind == "periods":  # the shift is four periods
        frame0 = frame1 = np.tile(surface[:, :40], 8)
    elif kind == "folded":
        flow[0, :, ::16] -= 24
    elif kind == "near":
        frame1, flow[0] = frame0, 0
    pyramid = pyramid_of(frame0, frame1, tisfm.Camera(focal=300.0), tisfm.Settings())
    assert confirms_large_motion(pyramid, flow, leaves_image(flow)) == (kind == "shifted")


def test_a_false_shift_of_a_texture_that_repeats_is_diverged():
    """The true shift is 18 px; the flow is 18 px and four periods."""
    surface = np.clip(np.rint(np.tile(texture(240, 480, 0)[:, :40], 9)), 0, 255).astype(np.uint8)
    result = tisfm.interpret(surface[:, :320], surface[:, 18:338])
    assert np.median(result.flow[..., 0]) < -160
    assert result.status == "diverged"


def bits():
    """Return a digest of two interpretations, for `tests/test_one_thread.py`."""
    frame0, frame1, _, _ = with_object(moved(np.eye(2, 3)), (60, 0))
    digest = hashlib.sha256(tisfm.interpret(frame0, frame1).rho.tobytes())
    frame0, frame1, _, _ = moved(AFAR)
    digest.update(tisfm.interpret(frame0, frame1).rho.tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize(("size", "other"), [((97, 151), (48, 76)), ((75, 113), (53, 79))])
@pytest.mark.parametrize("back", [False, True])
def test_flow_scales_between_levels_alike_along_both_axes(size, other, back):
    """Flow scales by the exact factor of the levels, although their sizes are rounded."""
    from tisfm.motion.matched_windows import resize_flow

    ratio = other[1] / size[1] + 0.003
    if back:
        size, other, ratio = other, size, 1 / ratio
    flow = np.broadcast_to(np.float32([100, -80]), (*size, 2)).copy()
    found = resize_flow(flow, other, ratio)
    assert found.shape == (*other, 2)
    np.testing.assert_allclose(found, np.broadcast_to(flow[0, 0] * ratio, found.shape), rtol=1e-5)


def test_the_noise_is_that_of_the_noisier_frame():
    from tisfm.motion.matched_windows import WindowSearch
    from tisfm.motion.problems import pyramid_of

    settings = tisfm.Settings(presmoothing=0.0)
    quiet = texture(200, 300, 0).astype(np.float32)
    noisy = quiet + np.random.default_rng(1).normal(0, 6, quiet.shape).astype(np.float32)

    def noise(frame0, frame1):
        pyramid = pyramid_of(frame0, frame1, tisfm.Camera(focal=300.0), settings)
        return WindowSearch(pyramid, 0).windows(0).noise

    assert noise(quiet, noisy) == noise(noisy, quiet) > 1.5 * noise(quiet, quiet)


@pairwise(preset=PRESETS, scene=["blocks", "sideways", "forward"], short=True)
def test_ordinary_pairs_keep_every_bit(monkeypatch, preset, scene):
    pair = two_blocks(240, 320) if scene == "blocks" else static_scene(scene, 240, 320)
    settings = tisfm.Settings.preset(preset)
    amended = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
    plain = without_proposals(
        monkeypatch, pair.frame0, pair.frame1, camera=pair.camera, settings=settings
    )
    np.testing.assert_array_equal(amended.rho, plain.rho)
    np.testing.assert_array_equal(amended.history.warp, plain.history.warp)


def test_noise_keeps_ordinary_pairs_ordinary(monkeypatch):
    pair = rendered("sideways", 240, 320)
    rng = np.random.default_rng(0)
    frames = [
        np.clip(frame + rng.normal(0, 10, frame.shape), 0, 255).astype(np.uint8)
        for frame in (pair.frame0, pair.frame1)
    ]
    amended = tisfm.interpret(*frames)
    np.testing.assert_array_equal(amended.rho, without_proposals(monkeypatch, *frames).rho)


def test_the_same_answer_twice_and_frames_are_left_alone():
    frame0, frame1, _, _ = with_object(moved(np.eye(2, 3)), (60, 0))
    given = frame0.copy(), frame1.copy()
    first, second = (tisfm.interpret(frame0, frame1) for _ in range(2))
    np.testing.assert_array_equal(first.flow, second.flow)
    np.testing.assert_array_equal((frame0, frame1), given)


@pairwise(
    size=[(64, 65), (67, 131), (251, 121), (12, 400), (4, 5)], levels=[None, 2, 1], short=True
)
def test_any_size_and_unrelated_frames(size, levels):
    frame0, frame1 = (
        np.random.default_rng(seed).integers(0, 255, size).astype(np.uint8) for seed in range(2)
    )
    settings = tisfm.Settings(pyramid_levels=levels)
    result = tisfm.interpret(frame0, frame1, settings=settings)
    assert result.flow.shape == (*size, 2)
    assert np.isfinite(result.flow).all()


def test_a_single_scale_and_tiny_frames_are_left_alone():
    from tisfm.motion.flow_proposals import flow_proposals
    from tisfm.motion.problems import flow_problem, pyramid_of

    def of(height, width, settings):
        frame = texture(height, width, 0).astype(np.float32)
        pyramid = pyramid_of(frame, frame, tisfm.Camera(focal=100.0), settings)
        return flow_proposals(pyramid, flow_problem(settings, 100.0))

    assert of(64, 64, tisfm.Settings()) is not None
    assert of(64, 64, tisfm.Settings.preset("paper")) is None
    assert of(63, 64, tisfm.Settings()) is None
    assert of(11, 4000, tisfm.Settings()) is None
    assert of(40, 2**15, tisfm.Settings()) is None


def test_outlines_are_those_of_the_images():
    from tisfm.motion.fast_objects import FastObjects
    from tisfm.motion.matched_windows import WindowSearch
    from tisfm.motion.problems import flow_problem, pyramid_of
    from tisfm.solver.coarse_to_fine import unknowns_on

    frame0, frame1, flow, body = with_object(moved(np.eye(2, 3), 97, 151), (40, 11), size=20)
    settings = tisfm.Settings(model="translation")
    frames = (frame.astype(np.float32) for frame in (frame0, frame1))
    pyramid = pyramid_of(*frames, tisfm.Camera(focal=100.0), settings)
    problem = flow_problem(settings, 100.0)
    unknowns = unknowns_on(pyramid, 0, problem)
    rough = cv2.erode(body.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    rho = np.zeros((3, *body.shape), np.float32)
    rho[:2] = np.where(rough, np.array([40, 11])[:, None, None], 0)
    unknowns.set_images(rho)
    FastObjects(rough, problem).cut_smoothness(WindowSearch(pyramid, 0).windows(0), unknowns)
    off = np.linalg.norm(np.moveaxis(unknowns.flow(), 0, -1) - flow, axis=-1)
    assert (off > 1).sum() < 30  # the outline has 80 px
    east, south = unknowns.to_images(unknowns.edges)
    told = unknowns.flow()[0] > 20
    across = told[:, 1:] != told[:, :-1]
    down = told[1:] != told[:-1]
    assert (east[:, :-1][across] < 1e-4).all()
    assert (south[:-1][down] < 1e-4).all()
    assert east[:, :-1][~across].min() > 1e-4
    assert (east[:, -1] == 0).all()
