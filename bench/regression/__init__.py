"""Results and speed of this code against another checkout: ``python -m bench.regression``.

Both interpret `pairs`. `checkout` runs each with its own interpreter and in its own processes, and
times them in turns. These processes run `worker`, which needs only NumPy and the public names of
tisfm. `report` compares the results. Imports tisfm and `bench.shared`.
"""
