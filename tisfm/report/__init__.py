"""Reports: a run or a reconstruction on one HTML page, which needs no network and no other file.

Here: the contents of a report, its pictures and drawings, the meaning of statuses, and the page.
May import: `tisfm.folders`, `tisfm.formats`, `tisfm.reconstruction`, `tisfm.results`, `tisfm.show`,
`tisfm.templates`, and of the top level `focal_guess`, `grade`, `interpretation`, `status`,
`settings` and `version`.
"""

from tisfm.folders.files import REPORT, is_report
from tisfm.report.page import check_report
from tisfm.report.reconstruction_report import write_reconstruction_report
from tisfm.report.run_report import write_run_report

__all__ = ["REPORT", "check_report", "is_report", "write_reconstruction_report", "write_run_report"]
