"""The viewer on long results: ``python -m bench.view``; `opening` opens a page in Chromium."""
