"""The report page: one HTML file that shows a run or a study, and needs no network."""

from maesn.reporting.page.documents import run_page as run_page
from maesn.reporting.page.documents import study_page as study_page
from maesn.reporting.page.writing import PAGE as PAGE
from maesn.reporting.page.writing import PlotlyMissing as PlotlyMissing
from maesn.reporting.page.writing import write_page as write_page
