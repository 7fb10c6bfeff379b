"""``tisfm report``: its arguments."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg


@dataclass(kw_only=True)
class Report:
    """Show a run or a reconstruction on one page.

    DIR is the folder that tisfm run or tisfm reconstruct wrote. It receives report.html, which
    needs no network and no other file: a summary, the path of the camera, statuses with advice,
    pictures of the frames with a slider, and settings.
    """

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """The folder of a run or a reconstruction."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.report_command import report

        return report(self.folder)
