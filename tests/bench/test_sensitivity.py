"""The benchmark that halves and doubles the settings of a stage."""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

import tisfm
from bench import sensitivity


@dataclass(frozen=True, kw_only=True)
class StageSettings:
    count: int = 5
    ratio: float = 0.5
    spans: tuple[float, ...] = (4.0, 8.0)
    name: str = "unused"
    is_used: bool = True


SETTINGS = StageSettings()
PACKAGE = Path(tisfm.__file__).parent
PATH = f"{__name__}.SETTINGS"


def measured(chosen, data):
    """Return figures: one depends on the count and on the second span, the other on nothing."""
    if SETTINGS.ratio > 0.9:
        raise ValueError("no path")
    return {"error": SETTINGS.count * SETTINGS.spans[1], "constant": 1.0}


def test_numbers_of_a_settings_object():
    numbers = sensitivity.numbers_of(SETTINGS)
    assert numbers == {("count", None): 5, ("ratio", None): 0.5, ("spans", 0): 4, ("spans", 1): 8}


def test_a_number_is_changed_and_restored():
    with pytest.raises(RuntimeError), sensitivity.changed(SETTINGS, "spans", 1, 0.5):
        assert SETTINGS.spans == (4.0, 4.0)
        raise RuntimeError
    assert StageSettings() == SETTINGS


@pytest.mark.parametrize(("value", "factor", "expected"), [(5, 2, 10), (1, 0.5, 1), (0.5, 2, 1.0)])
def test_whole_numbers_stay_whole_and_positive(value, factor, expected):
    scaled = sensitivity.scaled(value, factor)
    assert scaled == expected and type(scaled) is type(value)


def test_rows_and_report(monkeypatch):
    sensitivity.unchanged.cache_clear()
    monkeypatch.setattr(sensitivity, "measure", measured)
    cases = [(PATH, *key) for key in sensitivity.numbers_of(SETTINGS)]
    rows = {row[0]: row for row in (sensitivity.row_of(case, (), None) for case in cases)}
    sensitivity.unchanged.cache_clear()
    assert rows["SETTINGS.count"][2][1] == {"error": pytest.approx(100), "constant": 0}
    assert rows["SETTINGS.spans[1]"][2][0] == {"error": pytest.approx(-50), "constant": 0}
    assert rows["SETTINGS.spans[0]"][2] == [{}, {}]
    assert rows["SETTINGS.ratio"][2] == [{}, "ValueError: no path"]
    assert sensitivity.largest(rows["SETTINGS.ratio"][2][1])[0] == math.inf
    text = sensitivity.report([([PATH], list(rows.values()), measured((), None))])
    assert "1 of 4 numbers leave these figures the same: SETTINGS.spans[0]" in text
    lines = [line for line in text.splitlines() if line.startswith("| SETTINGS")]
    assert [line.split()[1] for line in lines] == [
        "SETTINGS.ratio",
        "SETTINGS.count",
        "SETTINGS.spans[1]",
    ]
    assert "+1e+02 (error)" in lines[1]


def test_unknown_settings_are_refused(capsys):
    assert sensitivity.main(["tisfm.reconstruction.NOTHING", "--smoke"]) == 2
    assert "NOTHING" in capsys.readouterr().err


def test_every_settings_object_has_an_input():
    """Settings objects are the capital names of the modules ``settings`` and ``grade``."""
    objects = set()
    for file in [*PACKAGE.rglob("settings.py"), PACKAGE / "grade.py"]:
        module = ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts)
        names = re.findall(r"^([A-Z_]+) = \w+Settings\(\)$", file.read_text(), re.MULTILINE)
        objects |= {f"{module}.{name}" for name in names}
    assert len(objects) > 20
    assert objects <= set().union(*sensitivity.STAGES.values())


def test_stages_are_grouped_by_the_inputs_that_reach_them():
    everything = sensitivity.plan([], ())
    assert dict(everything) == sensitivity.STAGES
    stage = sensitivity.STAGES["film",][0]
    assert sensitivity.plan([stage, PATH], ()) == [
        (("film",), [stage]),
        (sensitivity.INPUTS, [PATH]),
    ]
    assert sensitivity.plan([PATH], ("flow",)) == [(("flow",), [PATH])]
    for stages in sensitivity.STAGES.values():
        assert all(sensitivity.numbers_of(sensitivity.settings_of(name)) for name in stages)
