"""Reports: what was measured and identified, as one HTML file that needs neither network nor service. Pure."""

from service.report.content import Axis, Content, Revision, Row, axes_of
from service.report.diagnosis import diagnosis_figures, diagnosis_page
from service.report.page import render, render_analysis

__all__ = [
    "Axis",
    "Content",
    "Revision",
    "Row",
    "axes_of",
    "diagnosis_figures",
    "diagnosis_page",
    "render",
    "render_analysis",
]
