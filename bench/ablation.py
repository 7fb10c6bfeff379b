"""``python -m bench.ablation``, which is `bench.flow.ablation`."""

from bench.flow.ablation import main

if __name__ == "__main__":
    raise SystemExit(main())
