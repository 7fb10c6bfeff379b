"""Results and speed of this code beside another checkout: ``python -m bench.regression``.

Both interpret `pairs`. `checkout` runs each in processes of its own with its own interpreter, and
times them in turns; those processes run `worker`, which needs NumPy and the public names of tisfm
alone. `report` compares the results. Imports tisfm and `bench.shared`.
"""
