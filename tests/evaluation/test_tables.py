"""The tables that are printed."""

from tests.evaluation.evaluated import FAST, printed
from tisfm.datasets import find_pairs
from tisfm.evaluation import pairs
from tisfm.evaluation.pairs import PairEvaluation, evaluate


def test_the_table(data):
    result = evaluate(find_pairs(data), settings=FAST)
    rows = printed(result)
    assert [row[0] for row in rows] == [
        "mid/A", "mid/B", "mid, mean of 2", "road/000003", "valley/yos9", "all, mean of 4"
    ]  # fmt: skip
    for row, found in zip([*rows[:2], *rows[3:5]], result.pairs, strict=True):
        errors = found.errors
        assert row[1:5] == [
            f"{errors.endpoint:.3f}",
            f"{errors.angular:.2f}",
            f"{100 * errors.outliers:.2f}",
            f"{100 * errors.over_one:.2f}",
        ]
        assert row[5] == (f"{found.visible.endpoint:.3f}" if found.visible else "–")
        assert row[6] == (f"{found.without_sky.endpoint:.3f}" if found.without_sky else "–")
        assert row[7] == (f"{100 * found.occlusion.f1:.1f}" if found.occlusion else "–")
        assert row[8] == f"{found.seconds:.2f}"
    assert [bool(found.occlusion) for found in result.pairs] == [False, False, True, False]
    assert rows[-1][1] == f"{result.mean.errors.endpoint:.3f}"


def test_the_table_has_no_empty_columns(data):
    (data / "mid" / "A" / "frame10.png").unlink()
    rows = printed(evaluate(find_pairs(data / "mid"), settings=FAST))
    assert [row[0] for row in rows] == ["mid/A (failed)", "mid/B", "mid, mean of 1"]
    assert rows[0][1:] == ["–"] * 5
    assert rows[1][1:] == rows[2][1:]


def test_names_are_printed_without_markup(data):
    (pair,) = find_pairs(data / "mid" / "A")
    odd = type(pair)(**{**vars(pair), "dataset": "[red]set[/red]"})
    result = pairs.Evaluation(settings=FAST, pairs=(PairEvaluation(pair=odd, fault="no file"),))
    assert printed(result)[0][0] == "[red]set[/red]/A (failed)"
