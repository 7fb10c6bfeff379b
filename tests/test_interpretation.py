"""The result: its arrays, and the file that keeps them."""

import copy
import dataclasses
import io
import json
import pickle
import zipfile

import numpy as np
import pytest

import tisfm
from tisfm.formats import FormatError
from tisfm.interpretation import FORMAT, Interpretation, Status

H, W = 24, 40
ARRAYS = ("rho", "flow", "confidence", "occlusion", "frame")


def frames(seed=0, channels=()):
    frame0 = np.random.default_rng(seed).integers(0, 256, (H, W, *channels), dtype=np.uint8)
    return frame0, np.roll(frame0, 1, 1)


@pytest.fixture(scope="module")
def result():
    return tisfm.interpret(
        *frames(),
        camera=tisfm.Camera(50.0, center=(18.5, 12.25)),
        settings=tisfm.Settings.preset("paper", outer_iterations=4),
    )


@pytest.fixture
def saved(result, tmp_path):
    path = tmp_path / "result.npz"
    result.save(path)
    return path


def rewritten(path, **changes):
    """Replace or drop (None) entries of an .npz."""
    with np.load(path, allow_pickle=False) as file:
        entries = {name: file[name] for name in file.files}
    entries.update(changes)
    np.savez(path, **{name: value for name, value in entries.items() if value is not None})


def about(path, **changes):
    """Change what an .npz says about itself."""
    with np.load(path, allow_pickle=False) as file:
        text = json.loads(str(file["about"]))
    rewritten(path, about=np.array(json.dumps({**text, **changes})))


# Attributes


@pytest.mark.parametrize("model", ["rigid", "translation"])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_shapes_and_types(model, channels):
    result = tisfm.interpret(*frames(channels=channels), settings=tisfm.Settings(model=model))
    shapes = {
        "rho": (6, H, W),
        "tau": (3, H, W),
        "omega": (3, H, W),
        "flow": (H, W, 2),
        "inverse_depth": (H, W),
        "depth": (H, W),
        "confidence": (H, W),
    }
    for name, shape in shapes.items():
        array = getattr(result, name)
        assert (array.shape, array.dtype) == (shape, np.float32), name
        assert array.flags.c_contiguous, name
    assert (result.occlusion.shape, result.occlusion.dtype) == ((H, W), np.bool_)
    assert (result.frame.shape, result.frame.dtype) == ((H, W, *channels), np.uint8)
    assert np.isfinite(result.rho).all() and result.rho[:3].any()
    assert result.rho[3:].any() == (model == "rigid")
    assert result.confidence.min() >= 0 and result.confidence.max() <= 1
    assert result.camera == tisfm.Camera() and result.settings.model == model
    assert result.version == tisfm.__version__
    assert isinstance(result.status, str) and result.status.message


def test_history_is_one_row_per_iteration(result):
    history = vars(result.history)
    assert {len(array) for array in history.values()} == {len(result.history.level)}
    assert result.history.level.dtype == result.history.warp.dtype == np.int32
    for name in ("energy", "half_quadratic", "change"):
        assert history[name].dtype == np.float64
        assert np.isfinite(history[name]).all()


def test_tau_and_omega_are_rho_over_the_focal_length(result):
    focal = result.camera.focal
    np.testing.assert_allclose(result.tau * focal, result.rho[:3], rtol=1e-6)
    np.testing.assert_allclose(result.omega * focal, result.rho[3:], rtol=1e-6)


def test_depth_is_one_over_the_length_of_tau(result):
    length = np.linalg.norm(result.tau.astype(float), axis=0)
    np.testing.assert_allclose(result.inverse_depth, length, rtol=1e-6)
    np.testing.assert_allclose(result.depth, 1 / length, rtol=1e-6)


@pytest.mark.filterwarnings("error")
def test_depth_is_unknown_where_the_inverse_depth_is_not_positive(result):
    inverse_depth = result.inverse_depth.copy()
    inverse_depth[2:4, 7], inverse_depth[4, 7] = 0, -1
    changed = dataclasses.replace(result, inverse_depth=inverse_depth)
    unknown = np.zeros((H, W), bool)
    unknown[2:5, 7] = True
    np.testing.assert_array_equal(np.isnan(changed.depth), unknown)


@pytest.mark.filterwarnings("error")
def test_no_motion_is_exactly_zero():
    frame0, _ = frames()
    result = tisfm.interpret(frame0, frame0)
    assert not result.rho.any() and not result.flow.any() and not result.inverse_depth.any()
    assert np.isnan(result.depth).all()
    assert result.status == "no_motion" and "further apart" in result.status.message


def test_no_texture_is_said():
    uniform = np.full((H, W), 100, np.uint8)
    result = tisfm.interpret(uniform, uniform)
    assert result.status == "no_texture" and "textured" in result.status.message
    assert np.isfinite(result.flow).all()


def test_running_out_of_iterations_is_said():
    settings = tisfm.Settings(outer_iterations=1, tolerance=0)
    status = tisfm.interpret(*frames(), settings=settings).status
    assert status == "iteration_limit"
    assert "outer_iterations" in status.message and "tolerance 0" in status.message


def test_converging_is_said():
    status = tisfm.interpret(*frames(), settings=tisfm.Settings(tolerance=10.0)).status
    assert status == "converged" and "changed by" in status.message


def test_the_same_answer_twice(result):
    again = tisfm.interpret(*frames(), camera=result.camera, settings=result.settings)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))


def test_repr_is_short(result):
    text = repr(result)
    assert len(text) < 800 and "array" not in text
    assert "focal=50.0" in text and str(result.status) in text


def test_a_result_is_frozen(result):
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.rho = None


# Status


def test_a_status_compares_as_text():
    status = Status("converged", "all is well")
    assert status == "converged" and status != "no_motion"
    assert status in ("converged", "no_motion") and {status: 1}["converged"] == 1
    assert str(status) == f"{status}" == "converged" and isinstance(status, str)
    assert status.message == "all is well"
    assert Status("converged").message == ""


@pytest.mark.parametrize(
    "remake", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))]
)
def test_a_status_keeps_its_message_when_copied(remake):
    made = remake(Status("no_motion", "frames do not differ"))
    assert made == "no_motion" and made.message == "frames do not differ"


# Files


@pytest.mark.parametrize(
    "settings",
    [
        tisfm.Settings(),
        tisfm.Settings.preset("paper", outer_iterations=3),  # contrast None, one level
        tisfm.Settings(model="translation", contrast=0.1, pyramid_levels=2),
    ],
    ids=["default", "paper", "changed"],
)
@pytest.mark.parametrize("center", [None, (18.5, 12.25)])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_round_trip_is_exact(tmp_path, settings, center, channels):
    result = tisfm.interpret(
        *frames(channels=channels), camera=tisfm.Camera(123.4, center), settings=settings
    )
    result.save(tmp_path / "result.npz")
    loaded = Interpretation.load(tmp_path / "result.npz")
    for name in (*ARRAYS, "tau", "omega", "inverse_depth", "depth"):
        array, expected = getattr(loaded, name), getattr(result, name)
        np.testing.assert_array_equal(array, expected)
        assert array.dtype == expected.dtype
    for name, expected in vars(result.history).items():
        array = getattr(loaded.history, name)
        np.testing.assert_array_equal(array, expected)
        assert array.dtype == expected.dtype
    assert loaded.camera == result.camera and loaded.settings == result.settings
    assert loaded.status == result.status and isinstance(loaded.status, Status)
    assert loaded.status.message == result.status.message
    assert loaded.version == result.version


def test_another_version_is_kept(result, tmp_path):
    dataclasses.replace(result, version="0.0.7").save(tmp_path / "result.npz")
    assert Interpretation.load(tmp_path / "result.npz").version == "0.0.7"


def test_numbers_that_are_none_survive(result, tmp_path):
    """NaN and infinity, as a diverged result has them."""
    rho = result.rho.copy()
    rho[0, 0, :2] = np.nan, np.inf
    dataclasses.replace(result, rho=rho).save(tmp_path / "result.npz")
    np.testing.assert_array_equal(Interpretation.load(tmp_path / "result.npz").rho, rho)


def test_there_are_no_pickles_inside(saved):
    with np.load(saved, allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)
        json.loads(str(file["about"]))


def test_saving_twice_gives_the_same_bytes(result, saved, tmp_path):
    result.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == saved.read_bytes()


def test_no_suffix_is_added(result, tmp_path):
    result.save(str(tmp_path / "result"))
    assert [path.name for path in tmp_path.iterdir()] == ["result"]
    assert Interpretation.load(str(tmp_path / "result")).status == result.status


def test_saving_replaces_a_file(result, saved):
    saved.write_bytes(b"old")
    result.save(saved)
    assert Interpretation.load(saved).status == result.status


def test_saving_into_a_missing_folder_leaves_nothing(result, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"cannot write .*gone.* does not exist"):
        result.save(tmp_path / "gone" / "result.npz")
    assert not list(tmp_path.iterdir())


def test_saving_below_a_file_leaves_it(result, tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OSError, match="cannot write"):
        result.save(tmp_path / "file" / "result.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "mine"


def test_a_failed_save_leaves_the_file_before(result, saved, monkeypatch):
    before = saved.read_bytes()

    def full(file, **entries):
        file.write(b"PK")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match="No space left"):
        result.save(saved)
    assert saved.read_bytes() == before
    assert list(saved.parent.iterdir()) == [saved]


def refused(path, *words, error=FormatError):
    """Check that load refuses a file in one line that names it and holds these words."""
    with pytest.raises(error) as caught:
        Interpretation.load(path)
    text = str(caught.value)
    assert "\n" not in text and str(path) in text
    for word in words:
        assert word in text, text


def test_load_of_a_missing_file(tmp_path):
    refused(tmp_path / "no.npz", "does not exist", error=FileNotFoundError)


def test_load_of_a_folder(tmp_path):
    refused(tmp_path, "is a folder", error=IsADirectoryError)


def test_errors_of_load_are_value_errors():
    assert issubclass(FormatError, ValueError)


@pytest.mark.parametrize("share", [0, 1e-4, 0.01, 0.25, 0.5, 0.9, 0.99, 0.9999])
def test_load_of_a_file_that_is_cut_off(saved, share):
    data = saved.read_bytes()
    saved.write_bytes(data[: int(share * len(data))])
    refused(saved)


def test_load_of_a_file_that_lacks_its_last_byte(saved):
    saved.write_bytes(saved.read_bytes()[:-1])
    refused(saved, "not a complete interpretation")


def test_load_of_a_damaged_file(saved):
    """Each byte is one that a reader may stumble over in its own way; most are check-summed."""
    data = bytearray(saved.read_bytes())
    errors = 0
    for position in range(0, len(data), max(1, len(data) // 150)):
        data[position] ^= 0x5A
        saved.write_bytes(data)
        try:
            Interpretation.load(saved)
        except FormatError as error:
            errors += 1
            assert "\n" not in str(error)
        data[position] ^= 0x5A
    assert errors > 120


@pytest.mark.parametrize(
    "content",
    [b"", b"garbage" * 100, b"PK\x03\x04" + b"garbage" * 100, b"\x89PNG\r\n\x1a\n", b"\x80\x04N."],
    ids=["empty", "garbage", "garbled zip", "picture", "pickle"],
)
def test_load_of_something_else(tmp_path, content):
    (tmp_path / "other.npz").write_bytes(content)
    refused(tmp_path / "other.npz")


def test_load_of_a_single_array(tmp_path):
    with open(tmp_path / "array.npz", "wb") as file:
        np.save(file, np.zeros(3))
    refused(tmp_path / "array.npz", "it is not an .npz file")


def test_load_of_a_foreign_npz(tmp_path):
    np.savez(tmp_path / "foreign.npz", rho=np.zeros(3), data=np.zeros(3))
    refused(tmp_path / "foreign.npz", "it has no about, confidence, flow, frame")


def test_load_of_a_foreign_zip(tmp_path):
    with zipfile.ZipFile(tmp_path / "foreign.npz", "w") as file:
        file.writestr("readme.txt", "hello")
    refused(tmp_path / "foreign.npz", "it has no about")


def test_load_of_a_pickle_inside(saved):
    buffer = io.BytesIO()
    np.save(buffer, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(saved, "a") as file:
        file.writestr("extra.npy", buffer.getvalue())
    refused(saved)


@pytest.mark.parametrize("name", ["about", "rho", "flow", "confidence", "frame", "history_level"])
def test_load_without_an_entry(saved, name):
    rewritten(saved, **{name: None})
    refused(saved, name.removeprefix("history_"))


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("rho", np.zeros((3, H, W), np.float32)),
        ("rho", np.zeros((6, H, W), np.float64)),
        ("flow", np.zeros((2, H, W), np.float32)),
        ("confidence", np.zeros((H, W + 1), np.float32)),
        ("occlusion", np.zeros((H, W), np.uint8)),
        ("occlusion", np.zeros((H + 1, W), bool)),
    ],
)
def test_load_of_arrays_that_do_not_fit(saved, name, array):
    rewritten(saved, **{name: array})
    refused(saved, name, str(array.shape), "expected")


def as_format_1(path, result, **changes):
    """Turn a saved file into one of format 1, with other settings if need be."""
    settings = dataclasses.asdict(result.settings) | changes
    del settings["coarse_warps"]
    rewritten(path, occlusion=None)
    about(path, format=1, version="0.0.9", settings=settings)


def test_load_of_format_1(result, saved):
    as_format_1(saved, result, warps=4)
    older = Interpretation.load(saved)
    assert older.settings == dataclasses.replace(result.settings, warps=4, coarse_warps=4)
    x = np.arange(W) + result.flow[..., 0]
    y = np.arange(H)[:, None] + result.flow[..., 1]
    leaves = (x < -0.05) | (x > W - 0.95) | (y < -0.05) | (y > H - 0.95)
    np.testing.assert_array_equal(older.occlusion, leaves)
    assert leaves.any() and result.occlusion[leaves].all()


def test_load_of_format_1_that_has_what_it_need_not(result, saved):
    """As was written for a while before the format was raised."""
    about(saved, format=1)
    older = Interpretation.load(saved)
    assert older.settings == result.settings
    np.testing.assert_array_equal(older.occlusion, result.occlusion)


def test_format_1_is_written_anew_as_the_present_one(result, saved):
    as_format_1(saved, result)
    Interpretation.load(saved).save(saved)
    with np.load(saved, allow_pickle=False) as file:
        assert json.loads(str(file["about"]))["format"] == FORMAT
        assert "occlusion" in file.files
    assert Interpretation.load(saved).settings.coarse_warps == result.settings.warps


@pytest.mark.parametrize("name", ["smoothness", "warps", "coarse_warps"])
@pytest.mark.parametrize("form", [1, FORMAT])
def test_a_missing_setting_does_not_take_the_default_of_today(result, saved, form, name):
    settings = dataclasses.asdict(result.settings)
    if form == 1 and name != "coarse_warps":
        del settings["coarse_warps"]
    del settings[name]
    about(saved, format=form, settings=settings)
    if (form, name) == (1, "coarse_warps"):
        assert Interpretation.load(saved).settings.coarse_warps == result.settings.warps
    else:
        refused(saved, "its settings lack", name)


def test_the_present_format_has_a_map_of_occlusion(saved):
    rewritten(saved, occlusion=None)
    refused(saved, "it has no occlusion")


@pytest.mark.parametrize("form", [1, FORMAT])
def test_an_unknown_setting_is_named(result, saved, form):
    settings = dataclasses.asdict(result.settings) | {"gravity": 9.81}
    about(saved, format=form, settings=settings)
    refused(saved, "its settings have the unknown gravity")


def test_load_of_a_future_format(saved):
    about(saved, format=FORMAT + 1, version="9.9")
    refused(saved, f"its format is {FORMAT + 1}", f"reads 1 to {FORMAT}", "tisfm 9.9")


@pytest.mark.parametrize(
    "changes",
    [
        {"settings": {"model": "rigid", "gravity": 9.81}},
        {"settings": {"motion": "camera"}},
        {"settings": None},
        {"camera": {"focal": -3.0, "center": None}},
        {"camera": []},
        {"format": None},
    ],
    ids=str,
)
def test_load_of_what_this_version_does_not_know(saved, changes):
    about(saved, **changes)
    refused(saved)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "null"])
def test_load_of_a_damaged_account_of_itself(saved, text):
    rewritten(saved, about=np.array(text))
    refused(saved)
