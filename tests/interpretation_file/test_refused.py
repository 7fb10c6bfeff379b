"""Files that are no result: what is refused, and what it costs to find out."""

import dataclasses
import errno
import io
import json
import tracemalloc
import zipfile

import numpy as np
import pytest

from tests.draws import examples, long_draw_too
from tests.interpretation_file.stored import about, about_of, entries_of, rewritten
from tests.test_interpretation import ARRAYS, H, W
from tisfm.formats import FormatError, npz
from tisfm.interpretation import Interpretation
from tisfm.interpretation_file import FORMAT

# What is refused


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


def test_a_disk_that_fails_is_no_damage(saved, monkeypatch):
    def fails(*arguments):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(npz, "_read_header", fails)
    with pytest.raises(OSError, match="Input/output") as caught:
        Interpretation.load(saved)
    assert not isinstance(caught.value, FormatError)


def test_a_bug_of_ours_is_no_damage(saved, monkeypatch):
    def fails(about):
        raise LookupError("a bug")

    monkeypatch.setattr("tisfm.interpretation_file._read_camera", fails)
    with pytest.raises(LookupError, match="a bug"):
        Interpretation.load(saved)


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
    refused(saved, "not a complete .npz file")


@long_draw_too
def test_load_of_a_damaged_file(saved):
    """Each byte is one that a reader may stumble over in its own way; most are check-summed."""
    data = bytearray(saved.read_bytes())
    step = max(1, len(data) // examples(60, 300))
    errors = 0
    # All through the file, and every byte of the directory at its end.
    last = range(len(data) - 600, len(data), examples(5, 1))
    for position in (*range(0, len(data), step), *last):
        data[position] ^= 0x5A
        saved.write_bytes(data)
        try:
            Interpretation.load(saved)
        except FormatError as error:
            errors += 1
            assert "\n" not in str(error)
        data[position] ^= 0x5A
    assert errors > examples(50, 250)  # the others are times and permissions, which nobody reads


@pytest.mark.parametrize(
    "content",
    [b"", b"garbage" * 100, b"PK\x03\x04" + b"garbage" * 100, b"\x89PNG\r\n\x1a\n", b"\x80\x04N."],
    ids=["empty", "garbage", "garbled zip", "picture", "pickle"],
)
def test_load_of_other_files(tmp_path, content):
    (tmp_path / "other.npz").write_bytes(content)
    refused(tmp_path / "other.npz")


def test_load_of_a_single_array(tmp_path):
    with open(tmp_path / "array.npz", "wb") as file:
        np.save(file, np.zeros(3))
    refused(tmp_path / "array.npz", "not a complete .npz file")


def test_load_of_a_foreign_npz(tmp_path):
    np.savez(tmp_path / "foreign.npz", rho=np.zeros(3), data=np.zeros(3))
    refused(tmp_path / "foreign.npz", "it has no about, confidence, flow, frame")


def test_load_of_a_foreign_zip(tmp_path):
    with zipfile.ZipFile(tmp_path / "foreign.npz", "w") as file:
        file.writestr("readme.txt", "hello")
    refused(tmp_path / "foreign.npz", "it has no about")


def test_a_header_that_does_not_end_is_damage(tmp_path):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (3,"
    start = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(tmp_path / "open.npz", "w") as file:
        file.writestr("about.npy", start + bytes(24))
    refused(tmp_path / "open.npz", "not a complete .npz file")


# Parts that nobody asked for


def with_part(path, name, content, method=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "a", method) as file:
        file.writestr(name, content)


def npy(array, **options):
    buffer = io.BytesIO()
    np.save(buffer, array, **options)
    return buffer.getvalue()


@pytest.mark.parametrize("name", ["extra.npy", "readme.txt", "rho", "../rho.npy", "history_.npy"])
def test_load_of_an_unknown_part(saved, name):
    with_part(saved, name, npy(np.zeros(3)))
    refused(saved, "unknown part", name)


def test_load_of_a_pickle_inside(saved):
    with_part(saved, "extra.npy", npy(np.array([{"a": 1}], dtype=object), allow_pickle=True))
    refused(saved, "unknown part")


def test_load_of_a_pickle_for_an_array(saved):
    rewritten(saved, motions=np.array([{"a": 1}], dtype=object))
    refused(saved, "motions")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_load_of_a_part_twice(saved):
    with_part(saved, "rho.npy", npy(np.zeros((6, H, W), np.float16)))
    refused(saved, "rho twice")


def test_load_of_a_compressed_part(saved):
    rewritten(saved, np.savez_compressed)
    refused(saved, "compressed")


@pytest.mark.parametrize("name", ["extra.npy", "rho.npy"])
def test_a_small_file_stays_small(saved, name, tmp_path):
    """A gigabyte of zeros packed into a megabyte is not unpacked."""
    with zipfile.ZipFile(saved) as file:
        parts = {part: file.read(part) for part in file.namelist() if part != name}
    with zipfile.ZipFile(saved, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for part, content in parts.items():
            file.writestr(zipfile.ZipInfo(part), content)  # not compressed
        with file.open(name, "w") as big:
            shape = (2**24,)
            header = {"descr": "<f8", "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(big, header)
            for _ in range(128):
                big.write(bytes(2**20))
    assert saved.stat().st_size < 2**21
    tracemalloc.start()
    try:
        refused(saved)
        assert tracemalloc.get_traced_memory()[1] < 2**23
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("shape", [(6, 10**6, 10**6), (6, 2**62, 8), (2**31, 2**31, 2**31)])
def test_a_header_that_asks_for_too_much(saved, shape):
    """It is compared with the frame, and with the bytes that are there, before memory is taken."""
    with zipfile.ZipFile(saved) as file:
        parts = {part: file.read(part) for part in file.namelist()}
    for name, other in (("rho", "<f2"), ("frame", "|u1")):
        buffer = io.BytesIO()
        header = {"descr": other, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(buffer, header)
        with zipfile.ZipFile(saved, "w") as file:
            for part, content in {**parts, f"{name}.npy": buffer.getvalue()}.items():
                file.writestr(part, content)
        refused(saved, name, str(shape))


def test_a_frame_larger_than_its_bytes(saved):
    """All headers agree with each other; the bytes are not there."""
    with zipfile.ZipFile(saved) as file:
        parts = {part: file.read(part) for part in file.namelist()}
    big = (10**5, 10**5)
    shapes = {"rho": (6, *big), "flow": (*big, 2)}
    with zipfile.ZipFile(saved, "w") as file:
        for part, content in parts.items():
            array = np.load(io.BytesIO(content))
            if array.ndim > 1:
                buffer = io.BytesIO()
                header = {
                    "descr": array.dtype.str,
                    "fortran_order": False,
                    "shape": shapes.get(part.removesuffix(".npy"), big),
                }
                np.lib.format.write_array_header_1_0(buffer, header)
                content = buffer.getvalue() + array.tobytes()
            file.writestr(part, content)
    refused(saved, "its header says")


def test_running_out_of_memory_is_no_damage(saved, monkeypatch):
    def exhausted(*arguments):
        raise MemoryError

    monkeypatch.setattr(npz.np, "frombuffer", exhausted)
    refused(saved, "not enough memory to load", error=MemoryError)


# Arrays that do not fit


@pytest.mark.parametrize(
    "name", ["about", *ARRAYS, "inverse_depth", "history_level", "history_energy"]
)
def test_load_without_an_entry(saved, name):
    rewritten(saved, **{name: None})
    refused(saved, "it has no", name)


N = 4  # iterations
FAULTS = {
    "rho": [
        np.zeros((3, H, W), np.float16),
        np.zeros((6, H, W), np.float64),
        np.full((6, H, W), np.nan, np.float16),
    ],
    "flow": [
        np.zeros((2, H, W), np.float32),
        np.zeros((H, W, 2), np.float16),
        np.full((H, W, 2), np.inf, np.float32),
    ],
    "inverse_depth": [np.zeros((H, W), np.float64), np.full((H, W), np.inf, np.float32)],
    "confidence": [
        np.zeros((H, W + 1), np.float16),
        np.zeros((H, W), np.float32),
        np.full((H, W), -0.1, np.float16),
        np.full((H, W), 1.01, np.float16),
        np.full((H, W), np.nan, np.float16),
    ],
    "occlusion": [
        np.zeros((H, W), np.uint8),
        np.zeros((H + 1, W), bool),
        np.full((H, W), 2, np.uint8).view(bool),
    ],
    "frame": [
        np.zeros((H, W), np.float32),
        np.zeros((H, W), np.uint16),
        np.zeros((H, W, 4), np.uint8),
        np.zeros((H, W, 1), np.uint8),
        np.zeros(H, np.uint8),
        np.zeros((0, W), np.uint8),
        np.zeros((2, W), np.uint8),
        np.zeros((H, W, 3), np.uint8, order="F"),
    ],
    "history_level": [
        np.zeros(N + 1, np.int32),
        np.zeros(N, np.int64),
        np.zeros((N, 1), np.int32),
        np.zeros((), np.int32),
        np.full(N, -1, np.int32),
    ],
    "history_warp": [np.zeros(N - 1, np.int32), np.full(N, -1, np.int32)],
    "history_energy": [np.zeros(N + 1), np.zeros(N, np.float32), np.full(N, np.nan)],
    "history_half_quadratic": [np.zeros(0), np.full(N, np.nan)],
    "history_change": [np.zeros(N, ">f8"), np.full(N, np.nan)],
}


@pytest.mark.parametrize(
    ("name", "array"),
    [(name, array) for name, arrays in FAULTS.items() for array in arrays],
    ids=lambda value: value if isinstance(value, str) else f"{value.shape}{value.dtype}",
)
def test_load_of_arrays_that_do_not_fit(result, saved, name, array):
    assert len(result.history.level) == N
    rewritten(saved, **{name: array})
    refused(saved, "history_" if name == "history_level" else name)


RIGID_FAULTS = {
    "labels": [
        np.full((H, W), 2, np.uint8),
        np.full((H, W), -1, np.int32),
        np.zeros((H, W), np.int64),
        np.zeros((H, W, 1), np.uint8),
        None,
    ],
    "motions": [
        np.zeros((2, 5)),
        np.zeros((1, 6)),  # label 1 has none
        np.zeros((0, 6)),
        np.zeros(6),
        np.zeros((2, 6), np.float32),
        np.full((2, 6), np.nan),
        None,
    ],
    "inverse_depth_std": [
        np.zeros((H, W), np.float32),
        np.full((H, W), -1, np.float32),
        np.full((H, W), np.nan, np.float32),
        np.ones((H, W)),
        None,
    ],
}


@pytest.mark.parametrize(
    ("name", "array"),
    [(name, array) for name, arrays in RIGID_FAULTS.items() for array in arrays],
    ids=lambda value: value if isinstance(value, str) else f"{getattr(value, 'shape', '')}",
)
def test_load_of_rigid_motions_that_do_not_fit(saved_rigid, name, array):
    rewritten(saved_rigid, **{name: array})
    refused(saved_rigid, "labels" if name == "motions" and np.shape(array) == (1, 6) else name)


def test_a_field_has_no_motions(saved):
    rewritten(saved, motions=np.zeros((1, 6)))
    refused(saved, "it has motions", 'motion="field"')


@pytest.mark.parametrize("status", ["contradicted", "uncertain", "pose_mismatch"])
def test_a_field_has_no_status_of_rigid_motion(saved, status):
    about(saved, status=status)
    refused(saved, f"the status '{status}' does not occur", 'motion="field"')


# What it says about itself


@pytest.mark.parametrize("name", ["smoothness", "warps", "coarse_warps"])
def test_a_missing_setting_does_not_take_the_default_of_today(result, saved, name):
    settings = dataclasses.asdict(result.settings)
    del settings[name]
    about(saved, settings=settings)
    refused(saved, "missing in its settings", name)


def test_an_unknown_setting_is_named(result, saved):
    about(saved, settings=dataclasses.asdict(result.settings) | {"gravity": 9.81})
    refused(saved, "unknown in its settings: gravity")


@pytest.mark.parametrize("form", [1, 4, FORMAT - 1, FORMAT + 1, "8", None])
@pytest.mark.parametrize("write", [np.savez, np.savez_compressed])
def test_other_formats_are_named(saved, form, write):
    """Those before were compressed, and had other parts."""
    text = np.array(json.dumps({**about_of(saved), "format": form, "version": "0.0.9"}))
    rewritten(saved, write, about=text, occlusion=None, more=np.zeros(3))
    refused(saved, f"its format is {form!r}", f"reads format {FORMAT}", "tisfm 0.0.9")


@pytest.mark.parametrize(
    "changes",
    [
        {"settings": {"model": "rigid", "gravity": 9.81}},
        {"settings": {"motion": "camera"}},
        {"settings": None},
        *(
            {"camera": {"focal": v, "center": None, "distortion": None, "aspect": 1.0}}
            for v in (None, "x", True)
        ),
        {"camera": {"focal": 3.0, "center": [1, "a"], "distortion": None, "aspect": 1.0}},
        {"camera": {"focal": 3.0, "center": None, "distortion": 3, "aspect": 1.0}},
        {"format": 6.0},
        {"camera": {"focal": -3.0, "center": None, "distortion": None, "aspect": 1.0}},
        {"camera": {"focal": 3.0, "center": None, "distortion": [0.1], "aspect": 1.0}},
        {"camera": {"focal": 3.0, "center": None, "distortion": None, "skew": 0.0, "aspect": 1.0}},
        {"camera": {"focal": 3.0, "distortion": None, "aspect": 1.0}},
        {"camera": []},
        {"status": "Excellent"},
        {"status": "<img src=x onerror=alert(1)>"},
        {"status": ""},
        {"status": 3},
        {"status": ["converged"]},
        {"message": None},
        {"version": 1},
        {"more": 1},
    ],
    ids=str,
)
def test_load_of_unknown_entries(saved, changes):
    about(saved, **changes)
    refused(saved)


@pytest.mark.parametrize("name", ["smoothness", "stiffness", "warps"])
@pytest.mark.parametrize("value", ["x", 1.5j, None, [None], {}], ids=str)
def test_settings_of_another_type(saved, name, value):
    known = about_of(saved)["settings"]
    value = repr(value) if isinstance(value, complex) else value
    about(saved, settings={**known, name: value})
    refused(saved, name)


@pytest.mark.parametrize("status", ["no_motion", "no_texture"])
def test_depth_where_the_status_says_that_there_is_none(saved, status):
    about(saved, status=status)
    refused(saved, "inverse_depth is not 0", status)


@pytest.mark.parametrize(("value", "word"), [(-1e-3, "negative"), (np.inf, "infinite")])
def test_history_that_no_run_has(saved, value, word):
    change = entries_of(saved)["history_change"]
    change[-1] = value
    rewritten(saved, history_change=change)
    refused(saved, "history_change", word)


@pytest.mark.parametrize(
    "name",
    [
        "format",
        "version",
        "camera",
        "settings",
        "status",
        "message",
        "focal_deviation",
        "focal_effect",
        "focal_spread",
    ],
)
def test_load_without_a_word_about(saved, name):
    known = about_of(saved)
    del known[name]
    rewritten(saved, about=np.array(json.dumps(known)))
    refused(saved, "missing in", name)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "null", "[" * 100_000])
def test_load_of_a_damaged_account_of_itself(saved, text):
    rewritten(saved, about=np.array(text))
    refused(saved)


@pytest.mark.parametrize("array", [np.zeros(3), np.array(["a", "b"]), np.array(b"{}")])
def test_load_of_an_account_that_is_no_text(saved, array):
    rewritten(saved, about=array)
    refused(saved, "'about' is")


def test_load_of_an_endless_account(saved):
    rewritten(saved, np.savez_compressed, about=np.array(" " * 10_000_000))
    refused(saved, "about")
