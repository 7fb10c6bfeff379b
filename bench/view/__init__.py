"""The viewer on long results, in a real browser: ``python -m bench.view``.

`long_results` makes a run and a reconstruction of many frames from small ones, `opening` starts the
command and opens its page in Chromium.
"""
