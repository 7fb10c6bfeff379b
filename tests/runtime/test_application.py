"""Applications that started Taichi before tisfm does."""

import numpy as np
import pytest

from tests.runtime.programs import INTERPRET, UNDISTORT, answer, interpretation, run

STARTED = """
import os
os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"
import taichi as ti
ti.init(ti.cpu, log_level=ti.WARN, {options})
field = ti.field(ti.f32, 3)
field.fill(7.0)
from tisfm import runtime
assert runtime.lanes() > 1
"""
AFTERWARDS = """
result = interpret()
assert field[1] == 7.0  # the application's fields still live
np.save(sys.argv[1], result.rho)
print(digest(result))
"""
RESET = """
ti.reset()
assert digest(interpret()) == digest(result)  # kernels outlive their runtime
"""


@pytest.mark.parametrize(
    ("options", "same_bits"),
    [
        pytest.param(
            "real_matrix_scalarize=False, cpu_max_num_threads=1", True, marks=pytest.mark.nightly
        ),
        # The compiler takes vectors apart, and rounds otherwise.
        pytest.param("", False, marks=pytest.mark.nightly),
        pytest.param("debug=True", False, marks=pytest.mark.nightly),
    ],
)
def test_an_application_that_started_taichi_gets_the_same_answer(options, same_bits, tmp_path):
    program = STARTED.format(options=options) + INTERPRET + AFTERWARDS + RESET * same_bits
    ignored = "ignore::DeprecationWarning" if same_bits else "ignore"  # of slow compiling
    found = answer(program, tmp_path / "rho.npy", PYTHONWARNINGS=ignored).splitlines()[-1]
    result, expected = interpretation()
    assert found == expected or not same_bits
    assert np.abs(result.rho).max() > 0.1
    # A few units in the last place per iteration; seen: 2.5e-6 of values of about 1.
    np.testing.assert_allclose(np.load(tmp_path / "rho.npy"), result.rho, atol=1e-4)


@pytest.mark.parametrize("options", ["real_matrix_scalarize=False", "debug=True"])
def test_an_application_that_started_taichi_keeps_its_fields(options):
    """With `debug`, Taichi checks every index."""
    kept = "assert field[1] == 7.0\n"
    program = STARTED.format(options=options) + UNDISTORT + kept
    found = answer(program, PYTHONWARNINGS="ignore").splitlines()[-1]  # of slow compiling
    variables: dict = {}
    exec(UNDISTORT.replace("print(", "total = ("), variables)
    assert found == str(variables["total"])


def test_an_application_whose_kernels_compile_slowly_is_warned_at_once():
    """Before any compilation, once for each ``ti.init``, with the argument to pass."""
    code = """
    import os, sys, warnings
    os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"
    import taichi as ti
    from tisfm import runtime

    def warned(**options):
        ti.init(ti.cpu, log_level=ti.WARN, **options)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            runtime.start()
            runtime.start()
        return [str(one.message) for one in caught]

    (text,) = warned()
    assert "ti.init(arch=ti.cpu, real_matrix_scalarize=False)" in text, text
    assert "minutes to compile" in text, text
    assert warned(real_matrix_scalarize=False) == []
    assert len(warned()) == 1
    """
    answer(code)


def test_integers_of_64_bits_are_refused_with_advice():
    before = "import taichi as ti\nti.init(ti.cpu, default_ip=ti.i64, log_level=ti.ERROR)\n"
    done = run(before + INTERPRET + "interpret()")
    assert done.returncode == 1
    assert "start it with ti.i32" in done.stderr.splitlines()[-1]
