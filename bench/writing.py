"""``python -m bench.writing``, which is `bench.sequences.writing`."""

from bench.sequences.writing import main

if __name__ == "__main__":
    raise SystemExit(main())
