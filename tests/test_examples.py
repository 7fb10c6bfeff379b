"""The examples in docstrings: every public function and class has one, and each runs."""

import doctest
import inspect
from importlib import import_module

import pytest

from tests.draws import nightly_except
from tests.test_api import PUBLIC

METHODS = {
    "tisfm.Camera": ("with_focal", "scaled"),
    "tisfm.Interpretation": ("points", "save", "load"),
    "tisfm.Reconstruction": ("points", "mesh", "rescaled", "labels", "save", "load"),
    "tisfm.Settings": ("preset",),
}
NEEDS = {"tisfm.Reconstruction.mesh": "skimage", "tisfm.exports.write_meshes": "skimage",
         "tisfm.exports.write_video": "av"}  # fmt: skip


def with_examples():
    """Return the functions and classes of the public modules, and methods that users call."""
    found = {}
    for module, names in PUBLIC.items():
        for name in names:
            value = getattr(import_module(module), name)
            if not inspect.isroutine(value) and not inspect.isclass(value):
                continue  # a constant, or a type of literals
            if inspect.isclass(value) and issubclass(value, Exception):
                continue
            found[f"{module}.{name}"] = value
            for method in METHODS.get(f"{module}.{name}", ()):
                found[f"{module}.{name}.{method}"] = getattr(value, method)
    return found


EXAMPLES = with_examples()
LONG = ("tisfm.evaluation.evaluate", "tisfm.exports.write_colmap", "tisfm.exports.write_nerfstudio",
        "tisfm.horn_schunck.horn_schunck", "tisfm.reconstruct_stream")  # fmt: skip
SHORT = [name for name in EXAMPLES if name not in LONG]


def examples_of(name):
    """Return the example of a name as doctest has it, or None if there is none."""
    text = inspect.getdoc(EXAMPLES[name]) or ""
    _, heading, text = text.partition("\nExamples\n--------\n")
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    return example if heading and example.examples else None


@pytest.mark.parametrize("name", nightly_except(*SHORT, of=EXAMPLES))
def test_docstring_example_runs(name, documented_here):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    example = examples_of(name)
    assert example is not None, f"{name} has no example"
    assert not any(doctest.SKIP in part.options for part in example.examples)
    said = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS, verbose=False)
    runner.run(example, out=said.append)
    assert runner.failures == 0, "".join(said)
