"""Does this code answer as another checkout does, and as fast: ``python -m bench.regression``.

`pairs` are what both interpret, `checkout` runs each in processes of its own with its own
interpreter, `worker` is what those run: it needs NumPy and the public names of tisfm alone.
`compare` sets the answers side by side, `timing` takes times in turns, `report` writes. Imports
tisfm and `bench.shared`.
"""
