"""``python -m tisfm``: the same as the command ``tisfm``."""

import sys

from tisfm.cli import main

if __name__ == "__main__":
    sys.exit(main())
