"""The command line with rigid motions: every output with and without depth, poses, the guess."""

import re
from pathlib import Path

import numpy as np
import pytest

import tisfm
from tests.cli.command_line import RECORDS, files, kept, load, record
from tests.draws import nightly_except
from tisfm.formats import read_depth_png, read_flo, read_image, write_png
from tisfm.rigid import pose_matrix
from tisfm.running import pair_files, pair_writer
from tisfm.running.pair_files import motion_rows
from tisfm.scenes import two_blocks
from tisfm.show import depth_grey
from tisfm.status import Status

H, W = 60, 80
SCENE = two_blocks(
    H, W, camera_motion=(0.15, 0.02, 0.03, 0.002, 0.004, 0.003), block_motions=np.zeros((2, 6))
)
MOTION = pose_matrix(SCENE.motions[0])
CAMERA = ("--motion", "camera", "--focal", str(W))
ENDINGS = (
    ".npz", "_depth.png", "_depth16.png", "_anaglyph.png", "_figure.png", "_pose.txt",
)  # fmt: skip


@pytest.fixture(autouse=True)
def work_folder(tmp_path, monkeypatch):
    """A working folder with three frames: there and back again."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    (tmp_path / "frames").mkdir()
    for k, frame in enumerate((SCENE.frame0, SCENE.frame1, SCENE.frame0)):
        write_png(tmp_path / "frames" / f"f{k}.png", frame)
    return tmp_path


def to_world(*motions):
    """Poses, camera to world, of a camera that sees the scene move so."""
    poses = [np.eye(4)]
    for motion in motions:
        poses.append(poses[-1] @ np.linalg.inv(motion))
    return poses


def write_poses(path, poses):
    lines = [" ".join(f"{number:.12g}" for number in pose[:3].ravel()) for pose in poses]
    Path(path).write_text("\n".join(lines) + "\n")


def assert_one_line(code, err, *words):
    assert code == 1
    assert err.startswith("tisfm: ") and err.count("\n") == 1 and err.endswith("\n"), err
    for word in words:
        assert str(word) in err, err


# Outputs


def test_all_files_of_camera_motion_agree(tisfm_run):
    code, out, err = tisfm_run("run", "frames", "-o", "out", *CAMERA, "--ply", "--flo")
    assert code == 0 and out == ""
    assert err.startswith("2 pairs: 2 converged, ")
    names = ("f0", "f1")
    promised = {name + end for name in names for end in (*ENDINGS, ".ply", "_flow.flo")} | RECORDS
    assert set(files("out")) == promised
    about = record("out")
    assert about["settings"]["motion"] == "camera"
    scale = about["depth16_values_per_unit"]
    for name, frames in zip(
        names, ((SCENE.frame0, SCENE.frame1), (SCENE.frame1, SCENE.frame0)), strict=True
    ):
        result = load("out", name)
        settings = tisfm.Settings(motion="camera")
        expected = tisfm.interpret(*frames, camera=tisfm.Camera(W), settings=settings)
        for part in ("rho", "flow", "inverse_depth", "inverse_depth_std", "labels", "motions"):
            np.testing.assert_array_equal(getattr(result, part), getattr(kept(expected), part))
        np.testing.assert_array_equal(read_flo(f"out/{name}_flow.flo"), expected.flow)
        result = expected  # what the pictures are drawn of
        limit = about["depth_range"] * float(np.maximum(result.inverse_depth, 0).mean())
        np.testing.assert_array_equal(
            read_image(f"out/{name}_depth.png"), depth_grey(result.inverse_depth, limit=limit)
        )
        stored = read_depth_png(f"out/{name}_depth16.png")
        np.testing.assert_array_equal(np.isnan(stored), np.isnan(result.depth))
        inside = result.depth < 65535 / scale
        np.testing.assert_allclose(stored[inside], result.depth[inside], atol=0.51 / scale)
        rows = np.loadtxt(f"out/{name}_pose.txt", ndmin=2)
        assert rows.shape == (1, 12)
        np.testing.assert_allclose(rows, motion_rows(result), atol=1e-8)
        np.testing.assert_allclose(rows, about["pairs"][name]["motions"], atol=1e-8)
        assert np.linalg.norm(rows.reshape(3, 4)[:, 3]) == pytest.approx(1, abs=1e-4)
        count = int(re.search(rb"element vertex (\d+)", files("out")[f"{name}.ply"]).group(1))
        assert count == len(result.points()) > H * W / 2
    there, back = (np.loadtxt(f"out/{name}_pose.txt").reshape(3, 4) for name in names)
    np.testing.assert_allclose(there[:, :3] @ back[:, :3], np.eye(3), atol=2e-3)
    true = MOTION[:3, 3] / np.linalg.norm(MOTION[:3, 3])
    assert there[:, 3] @ true > 0.98


def test_negative_inverse_depth_has_no_depth(tmp_path):
    """As it is in the depth of the result: black, 0, and not in the mean that sets the range."""
    result = tisfm.interpret(
        SCENE.frame0, SCENE.frame1, camera=tisfm.Camera(W), settings=tisfm.Settings(motion="camera")
    )
    changed = result.inverse_depth.copy()
    changed[:, : W // 2] = -100 * changed[:, : W // 2]
    np.testing.assert_array_less(0, result.inverse_depth)
    signed = replaced(result, inverse_depth=changed)
    writer = pair_writer.PairWriter(
        tmp_path / "out", camera=result.camera, settings=result.settings
    )
    writer.write("pair", signed)
    behind = np.arange(W) < W // 2
    for ending in ("_depth.png", "_depth16.png"):
        picture = read_image(tmp_path / "out" / f"pair{ending}")
        assert not picture[:, behind].any() and picture[:, ~behind].all()
    kept = result.inverse_depth[:, ~behind]
    expected = np.percentile(kept, 95) / (kept.sum() / (H * W))
    assert record(tmp_path / "out")["depth_range"] == pytest.approx(expected, rel=1e-4)


def replaced(result, **arrays):
    fields = {name: getattr(result, name) for name in result.__dataclass_fields__}
    return tisfm.Interpretation(**{**fields, **arrays})


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    "status",
    nightly_except(
        "pure_rotation", "unrelated",
        of=["no_motion", "pure_rotation", "little_parallax", "no_texture", "unrelated"],
    ),
)  # fmt: skip
def test_outputs_without_depth(tisfm_run, work_folder, status):
    frame0 = SCENE.frame0 if status != "no_texture" else np.full((H, W), 7, np.uint8)
    frame1 = {
        "no_motion": SCENE.frame0,
        "no_texture": np.full((H, W), 9, np.uint8),
        "pure_rotation": np.roll(SCENE.frame0, 2, axis=1),
        "little_parallax": np.roll(SCENE.frame0, (1, 1), (0, 1)),
        "unrelated": np.random.default_rng(0).integers(0, 256, (H, W), np.uint8),
    }[status]
    two = [work_folder / "a.png", work_folder / "b.png"]
    write_png(two[0], frame0)
    write_png(two[1], frame1)
    focal = 150 if status == "little_parallax" else 600  # wide: a shift is no rotation there
    code, _, err = tisfm_run(
        "run", *two, "-o", "out", "--motion", "camera", "--focal", focal, "--ply"
    )
    assert code == 0
    first, advice = err.splitlines()
    assert first.startswith(f"1 pair: 1 {status}")
    assert advice.startswith(f"{status}: ") and len(advice) > 40
    assert set(files("out")) == {f"a{ending}" for ending in (*ENDINGS, ".ply")} | RECORDS
    result = load("out", "a")
    assert result.status == status
    assert not read_image("out/a_depth.png").any()
    assert not read_image("out/a_depth16.png").any()
    assert np.isnan(read_depth_png("out/a_depth16.png")).all()
    assert b"element vertex 0\n" in files("out")["a.ply"]
    anaglyph = read_image("out/a_anaglyph.png")  # without disparity grey stays grey
    np.testing.assert_array_equal(anaglyph, np.dstack([anaglyph[..., 0]] * 3))
    rows = np.loadtxt("out/a_pose.txt", ndmin=2)
    assert np.isfinite(rows).all()
    if status in ("no_motion", "no_texture", "unrelated"):
        np.testing.assert_array_equal(rows, [[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]])
    about = record("out")
    assert about["depth_range"] is None and about["depth16_values_per_unit"] is None


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_pair_without_depth_does_not_set_the_ranges(tisfm_run):
    pair = ["frames/f0.png", "frames/f1.png"]
    assert tisfm_run("run", *pair, "-o", "alone", *CAMERA, "--no-figures")[0] == 0
    code, _, err = tisfm_run("run", pair[0], *pair, "-o", "out", *CAMERA, "--no-figures")
    assert code == 0 and err.startswith("2 pairs: 1 no_motion, 1 converged")
    for key in ("depth_range", "depth16_values_per_unit", "flow_limit"):
        assert record("out")[key] == record("alone")[key]


def test_several_motions_are_lines_of_one_file(tmp_path):
    result = tisfm.interpret(
        SCENE.frame0, SCENE.frame1, camera=tisfm.Camera(W), settings=tisfm.Settings(motion="camera")
    )
    labels = np.zeros((H, W), np.int32)
    labels[20:40, 30:60] = 1
    second = np.array([0.6, 0, 0.8, 0, 0.1, 0])
    several = replaced(result, labels=labels, motions=np.vstack([result.motions, second]))
    writer = pair_writer.PairWriter(
        tmp_path / "out", camera=result.camera, settings=result.settings
    )
    writer.write("pair", several)
    rows = np.loadtxt(tmp_path / "out" / "pair_pose.txt")
    np.testing.assert_allclose(rows[1].reshape(3, 4), pose_matrix(second)[:3], atol=1e-8)
    assert record(tmp_path / "out")["pairs"]["pair"]["motions"] == motion_rows(several).tolist()
    one, two = (
        draw_size(tmp_path / name, writer_of, value)
        for name, writer_of, value in (("one", pair_writer, result), ("two", pair_writer, several))
    )
    assert two[1] > one[1]  # a panel more


def draw_size(folder, module, result):
    module.PairWriter(folder, camera=result.camera, settings=result.settings).write("pair", result)
    return read_image(folder / "pair_figure.png").shape


def test_motions_that_are_not_numbers_are_null(tmp_path):
    result = tisfm.interpret(
        SCENE.frame0, SCENE.frame0, settings=tisfm.Settings(motion="camera"),
        camera=tisfm.Camera(W),
    )  # fmt: skip
    wild = replaced(result, motions=np.full((1, 6), np.nan), status=Status("diverged"))
    writer = pair_writer.PairWriter(
        tmp_path / "out", camera=result.camera, settings=result.settings, figures=False
    )
    writer.write("pair", wild)
    assert record(tmp_path / "out")["pairs"]["pair"]["motions"] is None
    assert (tmp_path / "out" / "pair_pose.txt").read_text() == " ".join(["nan"] * 12) + "\n"


# The focal length


@pytest.mark.parametrize("given", [(), ("--focal", "guess")])
def test_the_focal_length_is_guessed_for_camera_motion(tisfm_run, given, recwarn):
    code, _, err = tisfm_run(
        "run", "frames", "-o", "out", "--motion", "camera", "--no-figures", *given
    )
    assert code == 0
    line, *others = err.splitlines()
    assert line.startswith("focal length guessed: 96 px (at 80×60), ")
    told, *advice = others
    assert told.startswith("2 pairs: ") and all("guessed focal length" in text for text in advice)
    assert record("out")["camera"]["focal"] == load("out", "f1").camera.focal == 1.2 * W
    assert not recwarn


def test_a_field_is_not_guessed_for(tisfm_run):
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--preset", "fast", "--no-figures")
    assert code == 0 and "guess" not in err
    assert record("out")["camera"]["focal"] == 600
    assert record("out")["pairs"]["f0"]["motions"] is None
    assert "f0_pose.txt" not in files("out")


# Poses


def test_depth_has_the_unit_of_the_poses(tisfm_run):
    longer = MOTION.copy()
    longer[:3, 3] *= 5
    poses = to_world(longer, np.linalg.inv(longer))
    start = pose_matrix((1, 2, 3, 0.5, -0.3, 0.2))  # the world is anywhere
    write_poses("poses.txt", [start @ pose for pose in poses])
    options = ("run", "frames", "-o", "out", *CAMERA, "--no-figures", "--poses", "poses.txt")
    assert tisfm_run(*options)[0] == 0
    for name, motion in (("f0", longer), ("f1", np.linalg.inv(longer))):
        rows = np.loadtxt(f"out/{name}_pose.txt").reshape(3, 4)
        np.testing.assert_allclose(rows, motion[:3], atol=1e-6)
    found = load("out", "f0").depth
    ratio = np.median((found / SCENE.depth)[SCENE.visible])
    assert ratio == pytest.approx(5, rel=0.03)
    limit = record("out")["depth_range"]  # in the unit of the poses, the same for all pairs
    for name in ("f0", "f1"):
        drawn = read_image(f"out/{name}_depth.png").astype(int)
        expected = depth_grey(load("out", name).inverse_depth, limit=limit)  # rounded
        assert np.abs(drawn - expected).max() <= 1


def test_poses_of_every_second_frame(tisfm_run, monkeypatch):
    seen = []
    original = tisfm.pair.interpret

    def interpret(*frames, pose=None, **options):
        seen.append(pose)
        return original(*frames, pose=pose, **options)

    monkeypatch.setattr(tisfm.pair, "interpret", interpret)
    motions = [pose_matrix((0.03, 0.01 * k, 0, 0, 0.002, 0)) for k in range(2)]
    write_poses("poses.txt", to_world(*motions))
    options = ("run", "frames", "-o", "out", *CAMERA, "--no-figures", "--poses", "poses.txt")
    assert tisfm_run(*options, "--step", "2")[0] == 0
    assert len(seen) == 1
    np.testing.assert_allclose(seen[0], motions[1] @ motions[0], atol=1e-9)


def test_resume_refuses_other_poses(tisfm_run):
    write_poses("poses.txt", to_world(MOTION, np.linalg.inv(MOTION)))
    longer = MOTION.copy()
    longer[:3, 3] *= 2
    write_poses("other.txt", to_world(longer, np.linalg.inv(longer)))
    options = ("run", "frames", "-o", "out", *CAMERA, "--no-figures")
    assert tisfm_run(*options, "--poses", "poses.txt")[0] == 0
    before = files("out")
    for other in ((), ("--poses", "other.txt")):
        code, _, err = tisfm_run(*options, "--resume", *other)
        assert_one_line(code, err, "another pose", "--resume")
    Path("out/f1.npz").unlink()
    assert tisfm_run(*options, "--resume", "--poses", "poses.txt")[0] == 0
    assert files("out") == before


@pytest.mark.parametrize("when", nightly_except("write_motions", of=["interpret", "write_motions"]))
def test_an_interrupted_run_is_resumed_to_the_same_bytes(tisfm_run, monkeypatch, when):
    options = ("--motion", "camera", "--no-figures")
    assert tisfm_run("run", "frames", "-o", "whole", *options)[0] == 0
    module = tisfm.pair if when == "interpret" else pair_files
    original, calls = getattr(module, when), []

    def interrupted(*arguments, **options):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return original(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(module, when, interrupted)
        assert tisfm_run("run", "frames", "-o", "out", *options)[0] == 130
    assert "f0.npz" in files("out") and "f1.npz" not in files("out")
    assert tisfm_run("run", "frames", "-o", "out", *options, "--resume")[0] == 0
    assert files("out") == files("whole")
    code, _, err = tisfm_run(
        "run", "frames", "-o", "out", "--focal", "96", "--no-figures", "--resume"
    )
    assert_one_line(code, err, "a run with other options")


IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, ["poses.txt"]),
        ("", ["poses.txt is empty"]),
        ("\n", ["poses.txt has 0 poses", "3 frames"]),
        (2 * IDENTITY, ["poses.txt has 2 poses", "3 frames", "every frame"]),
        (4 * IDENTITY, ["poses.txt has 4 poses", "3 frames"]),
        (IDENTITY + "1 0 0 0\n" + IDENTITY, ["poses.txt, line 2 has 4 numbers, expected 12"]),
        (2 * IDENTITY + "\nx" + IDENTITY[1:], ["poses.txt, line 4", "expected numbers"]),
        (IDENTITY + 12 * "1 " + "\n" + IDENTITY, ["poses.txt, line 2 is not a rotation"]),
        (2 * IDENTITY + IDENTITY.replace("0 0 0 0", "0 0 0 nan", 1),
         ["poses.txt, line 3 is not finite"]),
        (2 * IDENTITY + "-1 0 0 0 0 1 0 0 0 0 -1 0\n",
         ["poses.txt, frames 1 and 2: pose turns by 180°", "less than 90°"]),
    ],
)  # fmt: skip
def test_bad_poses_are_one_line(tisfm_run, text, words):
    if text is not None:
        Path("poses.txt").write_text(text)
    code, out, err = tisfm_run("run", "frames", "-o", "out", *CAMERA, "--poses", "poses.txt")
    assert out == ""
    assert_one_line(code, err, *words)
    assert not Path("out").exists()


@pytest.mark.parametrize("motion", ["field", "objects"])
def test_poses_are_for_rigid_motions(tisfm_run, motion):
    Path("poses.txt").write_text(3 * IDENTITY)
    code, _, err = tisfm_run(
        "run", "frames", "-o", "out", "--poses", "poses.txt", "--motion", motion
    )
    assert_one_line(code, err, "poses.txt", f"'{motion}'", "--motion camera")
    assert not Path("out").exists()


def test_poses_that_contradict_the_images(tisfm_run):
    """The depth is written, but sets no range for other pairs."""
    write_poses("poses.txt", to_world(np.linalg.inv(MOTION), MOTION))
    code, _, err = tisfm_run(
        "run", "frames", "-o", "out", *CAMERA, "--no-figures", "--poses", "poses.txt"
    )
    first, advice = err.splitlines()
    assert code == 0 and first.startswith("2 pairs: 2 pose_mismatch")
    assert advice.startswith("pose_mismatch: the given pose contradicts the images")
    assert "np.linalg.inv(pose)" in advice
    assert load("out", "f0").inverse_depth.any() and record("out")["depth_range"] is None


def test_poses_that_do_not_move_leave_no_depth(tisfm_run):
    Path("poses.txt").write_text(3 * IDENTITY)
    code, _, err = tisfm_run(
        "run", "frames", "-o", "out", *CAMERA, "--no-figures", "--poses", "poses.txt"
    )
    assert code == 0 and "2 pure_rotation" in err and "the given pose has no translation" in err
    assert not read_image("out/f0_depth.png").any()
