"""The HTML page of a results folder: a single file that opens from disk and needs no network.

Module `read` reads the files that the folder's manifest lists, and trusts none of them. Modules `body` and `views` draw the
interactive views. Module `rows` prepares the comparison of a study with the paper. Module `page` fills the template page.html.j2.
"""

from sunspin.output.report.page import write_report

__all__ = ["write_report"]
