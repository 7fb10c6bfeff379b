"""The file that keeps a result: what comes back, and what is refused."""

import dataclasses

import numpy as np
import pytest

import tisfm
from tests.interpretation_file.stored import (
    entries_of,
    half_precision,
    rigid_result,
)
from tests.test_interpretation import H, W, frames
from tisfm import interpretation_file
from tisfm.formats import npz
from tisfm.interpretation import Interpretation
from tisfm.status import Status

EXACT = ("flow", "inverse_depth", "depth", "occlusion", "frame", "labels", "motions",
         "inverse_depth_std")  # fmt: skip


def assert_same(loaded, result):
    for name in EXACT:
        array, expected = getattr(loaded, name), getattr(result, name)
        np.testing.assert_array_equal(array, expected)
        if expected is not None:
            assert array.dtype == expected.dtype and array.flags.writeable
    for name in ("rho", "confidence"):
        array, expected = getattr(loaded, name), getattr(result, name)
        assert array.dtype == np.float32 and array.flags.writeable
        np.testing.assert_array_equal(array, half_precision(expected))
    for name, expected in vars(result.history).items():
        array = getattr(loaded.history, name)
        np.testing.assert_array_equal(array, expected)
        assert array.dtype == expected.dtype
    assert loaded.camera == result.camera and loaded.settings == result.settings
    assert loaded.status == result.status and isinstance(loaded.status, Status)
    assert loaded.status.message == result.status.message
    assert loaded.version == result.version


# What comes back


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
def test_round_trip(tmp_path, settings, center, channels):
    result = tisfm.interpret(
        *frames(channels=channels), camera=tisfm.Camera(123.4, center), settings=settings
    )
    result.save(tmp_path / "result.npz")
    assert_same(Interpretation.load(tmp_path / "result.npz"), result)


def test_round_trip_of_rigid_motions(rigid, saved_rigid):
    assert_same(Interpretation.load(saved_rigid), rigid)
    assert entries_of(saved_rigid)["labels"].dtype == np.uint8


@pytest.mark.parametrize(
    ("count", "dtype"), [(256, np.uint8), (257, np.uint16), (70_000, np.int32)]
)
def test_many_labels(rigid, tmp_path, count, dtype):
    labels = np.full((H, W), count - 1, np.int32)
    motions = np.tile(rigid.motions[:1], (count, 1))
    dataclasses.replace(rigid, labels=labels, motions=motions).save(tmp_path / "many.npz")
    assert entries_of(tmp_path / "many.npz")["labels"].dtype == dtype
    np.testing.assert_array_equal(Interpretation.load(tmp_path / "many.npz").labels, labels)


def test_rounding_is_small(result, saved):
    loaded = Interpretation.load(saved)
    error = np.abs(loaded.rho - result.rho)
    assert (error <= np.maximum(2.0**-11 * np.abs(result.rho), 2.0**-25)).all()
    assert np.abs(loaded.confidence - result.confidence).max() <= 2.0**-12


def test_saving_again_changes_nothing(saved, tmp_path):
    Interpretation.load(saved).save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == saved.read_bytes()


def test_saving_again_keeps_the_sign_of_zero(result, tmp_path):
    rho = np.full_like(result.rho, -1e-9)  # which halves round to −0
    dataclasses.replace(result, rho=rho).save(tmp_path / "once.npz")
    Interpretation.load(tmp_path / "once.npz").save(tmp_path / "again.npz")
    assert np.signbit(entries_of(tmp_path / "once.npz")["rho"]).all()
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "once.npz").read_bytes()


def test_halves_without_help(result, saved, monkeypatch):
    """As with versions of OpenCV that cannot."""

    def cannot(*arguments, **options):
        raise interpretation_file.cv2.error("no such type")

    before = saved.read_bytes()
    monkeypatch.setattr(interpretation_file.cv2, "add", cannot)
    result.save(saved)
    assert saved.read_bytes() == before


def test_any_reader_of_numpy_reads_it(result, saved):
    """The bytes of a pixel are those that the documentation states."""
    entries = entries_of(saved)
    np.testing.assert_array_equal(entries["flow"], result.flow)
    pixels = sum(array.nbytes for array in entries.values() if array.shape[-2:] == (H, W))
    assert pixels + entries["flow"].nbytes == (12 + 4 + 2 + 1 + 1 + 8) * H * W
    assert saved.stat().st_size < pixels + entries["flow"].nbytes + 12_000


def test_another_version_is_kept(result, tmp_path):
    dataclasses.replace(result, version="0.0.7").save(tmp_path / "result.npz")
    assert Interpretation.load(tmp_path / "result.npz").version == "0.0.7"


@pytest.mark.parametrize("status", ["diverged", "pose_mismatch"])
def test_numbers_that_are_none_survive(result, tmp_path, status):
    """NaN, infinity and what float16 cannot hold, as a diverged result has them."""
    if status == "pose_mismatch":  # of a pose, which a field has not
        result = rigid_result()
    rho, confidence = result.rho.copy(), result.confidence.copy()
    rho[0, 0, :4] = np.nan, np.inf, -1e30, 65519
    confidence[3, 3] = np.nan
    energy = result.history.energy.copy()
    energy[-1] = np.nan
    wild = dataclasses.replace(
        result,
        rho=rho,
        confidence=confidence,
        status=Status(status, "wild"),
        history=dataclasses.replace(result.history, energy=energy),
    )
    wild.save(tmp_path / "result.npz")
    loaded = Interpretation.load(tmp_path / "result.npz")
    np.testing.assert_array_equal(loaded.rho, rho)
    assert np.isnan(loaded.confidence[3, 3])
    np.testing.assert_array_equal(loaded.history.energy, energy)


def test_an_energy_that_overflows_survives(result, tmp_path):
    energy = np.full_like(result.history.energy, np.inf)
    history = dataclasses.replace(result.history, energy=energy)
    dataclasses.replace(result, history=history).save(tmp_path / "result.npz")
    np.testing.assert_array_equal(
        Interpretation.load(tmp_path / "result.npz").history.energy, energy
    )


def test_a_result_without_iterations(result, tmp_path):
    none = {name: array[:0] for name, array in vars(result.history).items()}
    history = dataclasses.replace(result.history, **none)
    dataclasses.replace(result, history=history).save(tmp_path / "result.npz")
    assert len(Interpretation.load(tmp_path / "result.npz").history.level) == 0


def test_there_are_no_pickles_inside(saved):
    assert all(array.dtype != object for array in entries_of(saved).values())


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


def test_a_failed_save_leaves_the_file_before(result, saved, monkeypatch):
    before = saved.read_bytes()

    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(npz.np.lib.format, "write_array_header_1_0", full)
    with pytest.raises(OSError, match="No space left"):
        result.save(saved)
    assert saved.read_bytes() == before
    assert list(saved.parent.iterdir()) == [saved]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rho": np.full((6, H, W), np.nan, np.float32)}, "rho is not finite"),
        ({"confidence": np.full((H, W), 1.5, np.float32)}, "confidence is 1.5"),
        ({"flow": np.zeros((2, H, W), np.float32)}, "flow is"),
        ({"labels": np.zeros((H, W), np.int32)}, "it has labels"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_invalid_results_are_not_written(result, tmp_path, changes, words):
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(result, **changes).save(tmp_path / "result.npz")
    assert not list(tmp_path.iterdir())
