"""The command line, ``tisfm``.

Here: its arguments, the commands behind them, the files and the text that they leave, the demo
and the paper's figures.
May import: all of `tisfm`; nothing imports it.
"""

from tisfm.machine.address_space import require_for_import

require_for_import(0.25e9)  # SciPy hangs where there is less


def main() -> int:
    """Run the command line."""
    from tisfm.cli.command_line import main as run

    return run()
