"""Reports: what was measured and identified, as one HTML file that needs neither network nor service, or PDF. Pure."""

from service.report.assembly import content_of, example_of, used_sweeps
from service.report.campaign import CampaignReport, Drive, campaign_page
from service.report.content import Axis, Content, Revision, Row, axes_of
from service.report.diagnosis import diagnosis_figures, diagnosis_page
from service.report.html import Form, Page
from service.report.page import analysis_page, estimate_page
from service.report.paper.pdf import NoPdf

__all__ = [
    "Axis",
    "CampaignReport",
    "Content",
    "Drive",
    "Form",
    "NoPdf",
    "Page",
    "Revision",
    "Row",
    "analysis_page",
    "axes_of",
    "campaign_page",
    "content_of",
    "diagnosis_figures",
    "diagnosis_page",
    "estimate_page",
    "example_of",
    "used_sweeps",
]
