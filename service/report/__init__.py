"""Reports of measurement and identification: one HTML file without need of network or service, or PDF. Pure functions.

Each name is imported at its first use: the service collects the content of a report, its worker draws it.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from service.report.assembly import content_of, example_of, used_sweeps
    from service.report.campaign import campaign_page
    from service.report.content import Axis, CampaignReport, Content, Drive, Revision, Row, axes_of
    from service.report.diagnosis import diagnosis_figures, diagnosis_page
    from service.report.html import Form, Page
    from service.report.page import analysis_page, estimate_page
    from service.report.plant.fleet import fleet_page

_MODULES = {
    "Axis": "content",
    "CampaignReport": "content",
    "Content": "content",
    "Drive": "content",
    "Form": "html",
    "Page": "html",
    "Revision": "content",
    "Row": "content",
    "analysis_page": "page",
    "axes_of": "content",
    "campaign_page": "campaign",
    "content_of": "assembly",
    "diagnosis_figures": "diagnosis",
    "diagnosis_page": "diagnosis",
    "estimate_page": "page",
    "example_of": "assembly",
    "fleet_page": "plant.fleet",
    "used_sweeps": "assembly",
}

__all__ = [
    "Axis",
    "CampaignReport",
    "Content",
    "Drive",
    "Form",
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
    "fleet_page",
    "used_sweeps",
]


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
