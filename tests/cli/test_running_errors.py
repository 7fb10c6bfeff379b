"""The expected error in the progress bar counts every frame once."""

from tisfm.cli.progress import RunningErrors


def test_a_frame_with_new_depth_counts_once():
    errors = RunningErrors()
    assert errors.text == ""
    for frame, error in enumerate((0.02, 0.5, 0.5)):
        errors.add(frame, error)
    assert errors.text == "off by 50 %"
    errors.add(1, 0.04)  # its depth was found anew
    errors.add(2, float("nan"))
    assert errors.text == "off by 4 %"
