"""``python -m tisfm.cli`` is the command ``tisfm``."""

import sys

from tisfm.cli.command_line import main

if __name__ == "__main__":
    sys.exit(main())
