"""Reports of measurement and identification: one HTML file without need of network or service, or PDF. Pure functions.

Each name is imported at its first use: the service collects the content of a report, its worker draws it.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from service.report.campaign import campaign_page
    from service.report.content import (
        CampaignReport,
        Content,
        Drive,
        ReportedAxis,
        TruthRow,
        axes_of,
        content_of,
        example_of,
        used_sweeps,
    )
    from service.report.diagnosis import diagnosis_figures, diagnosis_page
    from service.report.fleet import fleet_page
    from service.report.html import Form, ReportPage, makes_pdf
    from service.report.page import analysis_page

_HOMES = {
    "campaign": ("campaign_page",),
    "content": (
        *("ReportedAxis", "CampaignReport", "Content", "Drive", "TruthRow"),
        *("axes_of", "content_of", "example_of", "used_sweeps"),
    ),
    "diagnosis": ("diagnosis_figures", "diagnosis_page"),
    "fleet": ("fleet_page",),
    "html": ("Form", "ReportPage", "makes_pdf"),
    "page": ("analysis_page",),
}

__all__ = [
    "CampaignReport",
    "Content",
    "Drive",
    "Form",
    "ReportPage",
    "ReportedAxis",
    "TruthRow",
    "analysis_page",
    "axes_of",
    "campaign_page",
    "content_of",
    "diagnosis_figures",
    "diagnosis_page",
    "example_of",
    "fleet_page",
    "makes_pdf",
    "used_sweeps",
]


def __getattr__(name: str) -> object:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
