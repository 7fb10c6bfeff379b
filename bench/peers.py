"""``python -m bench.peers``, which is `bench.flow.peers`."""

from bench.flow.peers import main

if __name__ == "__main__":
    raise SystemExit(main())
