"""``python -m bench.solvers``, which is `bench.flow.solvers`."""

from bench.flow.solvers import main

if __name__ == "__main__":
    raise SystemExit(main())
