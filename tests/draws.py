"""How much a test draws: little in the README's command, much under `pytest -m nightly`."""

import pytest
from hypothesis import HealthCheck, is_hypothesis_test, settings

# A machine that does other work may take any time for an example. The short draw is the same in
# every run, so that a change that has nothing to do with it never fails on it.
COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("short", max_examples=25, derandomize=True, **COMMON)
settings.register_profile("nightly", max_examples=400, **COMMON)

_nightly = False


def configure(config):
    """Choose the draw by the marker expression (-m) of this run."""
    global _nightly
    _nightly = "nightly" in config.option.markexpr.replace("not nightly", "")
    settings.load_profile("nightly" if _nightly else "short")


def examples(short, nightly):
    """Return the number of examples that a property draws, for hypothesis' `max_examples`."""
    return nightly if _nightly else short


def long_draw_too(test):
    """Decorate a test that draws by `examples`: it also runs under -m nightly."""
    test.has_long_draw = True
    return test


def mark_drawn(items):
    """Under -m nightly, properties run once more, with their long draw."""
    for item in items:
        test = getattr(item, "obj", None)
        if _nightly and (is_hypothesis_test(test) or hasattr(test, "has_long_draw")):
            item.add_marker("nightly")


def nightly_except(*short, of):
    """Return the values `of` as parameters, those not among `short` marked nightly."""
    return [
        value if value in short else pytest.param(value, marks=pytest.mark.nightly) for value in of
    ]
