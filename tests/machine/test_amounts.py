"""Times and sizes in words."""

from hypothesis import example, given
from hypothesis import strategies as st

from tisfm.machine.text import as_duration, as_size


def test_durations_and_sizes():
    assert [as_duration(s) for s in (0.5, 9.994, 61, 90, 100, 180, 600, 7200, 7500)] == [
        "0.50 s", "9.99 s", "61 s", "90 s", "1 min 40 s", "3 min", "10 min", "2 h", "2 h 5 min",
    ]  # fmt: skip
    assert [as_size(s) for s in (2.5e6, 3.21e9)] == ["2 MB", "3.2 GB"]


@given(st.floats(0, 1e7))
@example(90.0)
@example(99.6)
@example(599.6)
def test_a_duration_says_the_time_to_two_digits(seconds):
    units = {"s": 1, "min": 60, "h": 3600}
    words = as_duration(seconds).split()
    told = sum(float(n) * units[unit] for n, unit in zip(words[::2], words[1::2], strict=True))
    assert abs(told - seconds) <= max(0.005, 0.05 * seconds)
