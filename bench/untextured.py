"""``python -m bench.untextured``, which is `bench.flow.untextured`."""

from bench.flow.untextured import main

if __name__ == "__main__":
    raise SystemExit(main())
