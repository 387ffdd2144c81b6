"""Reports: what was measured and identified, as one HTML file that needs neither network nor service. Pure."""

from service.report.assembly import content_of, example_of, used_sweeps
from service.report.campaign import CampaignReport, Drive, render_campaign
from service.report.content import Axis, Content, Revision, Row, axes_of
from service.report.diagnosis import diagnosis_figures, diagnosis_page
from service.report.page import render, render_analysis

__all__ = [
    "Axis",
    "CampaignReport",
    "Content",
    "Drive",
    "Revision",
    "Row",
    "axes_of",
    "content_of",
    "diagnosis_figures",
    "diagnosis_page",
    "example_of",
    "render",
    "render_analysis",
    "render_campaign",
    "used_sweeps",
]
