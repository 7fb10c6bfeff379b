"""Pages without a browser: to wait for what they show, and to set their controls."""

import time


def wait_for(condition, seconds=120.0):
    """Wait until something is so; the limit is for machines that do much else."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.02)


def wait_until_drawn(page):
    """Wait until a page has drawn all that was asked of it."""
    wait_for(lambda: page._jobs.empty() and not (page._is_coarse or page._is_stale))


def change(page, name, value):
    """Set a control; its own listeners have to do the rest."""
    getattr(page.controls, name).value = value
