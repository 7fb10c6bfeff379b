"""``python -m bench.focal``, which is `bench.depth.focal`."""

from bench.depth.focal import main

if __name__ == "__main__":
    raise SystemExit(main())
