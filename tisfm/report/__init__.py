"""A run or a reconstruction on one page of HTML, which needs no network and no other file.

Here: what is chosen of a result, its pictures and drawings, what statuses mean, and the page.
May import: `tisfm.folders`, `tisfm.formats`, `tisfm.reconstruction`, `tisfm.show`, and of the top
level `camera`,
`focal_guess`, `interpretation`, `status`, `settings` and `version`.
"""

from tisfm.folders.side_files import REPORT, is_report
from tisfm.report.file import refuse_foreign
from tisfm.report.reconstruction_report import write_reconstruction_report
from tisfm.report.run_report import write_run_report

__all__ = [
    "REPORT",
    "is_report",
    "refuse_foreign",
    "write_reconstruction_report",
    "write_run_report",
]
