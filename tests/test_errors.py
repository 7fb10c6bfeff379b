"""Errors for the user have classes of their own; everything else is a bug."""

import ast
import pickle

import numpy as np
import pytest

import tisfm
from tests.imports import sources
from tisfm import errors
from tisfm.errors import TisfmError, is_user_error

BUILT_IN = {
    errors.InputError: ValueError,
    errors.InputTypeError: TypeError,
    errors.OutOfRangeError: IndexError,
    errors.RunError: RuntimeError,
    errors.MissingPackageError: ImportError,
    errors.OutOfMemoryError: MemoryError,
}


@pytest.mark.parametrize(("kind", "built_in"), BUILT_IN.items())
def test_each_is_a_built_in_exception_and_goes_between_processes(kind, built_in):
    copy = pickle.loads(pickle.dumps(kind("text")))
    assert type(copy) is kind and str(copy) == "text"
    assert isinstance(copy, built_in) and isinstance(copy, TisfmError)


def test_arguments_that_are_wrong_are_user_errors():
    for call in (lambda: tisfm.Camera(focal=-1.0), lambda: tisfm.Camera(focal="long")):
        with pytest.raises(TisfmError) as caught:
            call()
        assert is_user_error(caught.value)


def test_errors_of_libraries_are_bugs():
    with pytest.raises(ValueError, match="broadcast") as caught:
        np.zeros(2) + np.zeros(3)
    assert not is_user_error(caught.value)
    assert is_user_error(FileNotFoundError("gone.png")) and is_user_error(MemoryError())


def test_tisfm_raises_no_built_in_exception_that_would_look_like_a_bug():
    """A module that is run in a process of its own, the probe of the doctor, may."""
    names = {kind.__name__ for kind in BUILT_IN.values()} | {"ModuleNotFoundError"}
    found = []
    for name, path in sources().items():
        if name.startswith("tisfm.kernels") or name == "tisfm.doctor.probe":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                raised = ast.unparse(node.exc.func)
                if raised in names:
                    found.append(f"{name}:{node.lineno} raises {raised}")
    assert found == []
