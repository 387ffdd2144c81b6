"""The section of a report: its sentence says what the figures say."""

import re

import pytest

from service.benefit import Benefit, benefit, benefit_section, sentence
from service.benefit.section import worth
from service.report import Page
from service.report.plotting import svg
from tests.unit.service.benefit import pair


@pytest.fixture(scope="module")
def found() -> Benefit:
    return benefit(pair.robot(), pair.sweeps([0.0, 0.3, 0.6, 0.2, 0.9, 0.5, 0.1, 0.8]))


def as_good_as_cad(found: Benefit) -> Benefit:
    """As where the estimate has won nothing."""
    axis = found.axes["j1"]
    return found.model_copy(update={"axes": {"j1": axis.model_copy(update={"identified": axis.cad})}})


def test_the_sentence_names_both_models(found: Benefit) -> None:
    axis = found.axes["j1"]
    numbers = [float(number) for number in re.findall(r"\d+(?:\.\d+)?(?:e-\d+)?", sentence(found))]
    assert numbers == pytest.approx(
        [
            axis.identified.left_percent,
            axis.cad.left_percent,
            axis.identified.smallest_force,
            axis.cad.smallest_force,
        ],
        rel=0.05,
    )
    assert "no better" not in sentence(found)


def test_where_nothing_is_won_the_sentence_says_so(found: Benefit) -> None:
    assert sentence(as_good_as_cad(found)).endswith("On j1 the estimate is no better than CAD.")


def test_an_axis_through_the_end_of_the_robot_has_no_force(found: Benefit) -> None:
    axis = found.axes["j1"]
    models = {
        name: model.model_copy(update={"smallest_force": None})
        for name, model in (("cad", axis.cad), ("identified", axis.identified))
    }
    alone = found.model_copy(update={"axes": {"j1": axis.model_copy(update=models)}})
    assert "push" not in sentence(alone)
    page = Page("worth")
    benefit_section(page, alone)
    assert "–" in page.html()


def test_figure_and_table_of_the_report(found: Benefit) -> None:
    page = Page("worth")
    benefit_section(page, found)
    html = page.html()
    assert "What you gain" in html
    assert html.count("<figure>") == 1
    assert "j1, estimate" in html
    bars = worth(found)["data"]
    assert [bar["y"] for bar in bars][:2] == [
        [found.axes["j1"].cad.left_percent],
        [found.axes["j1"].identified.left_percent],
    ]
    assert "smallest force seen in N" in svg(worth(found), "worth")


def test_what_is_not_judged_is_told_without_a_figure() -> None:
    page = Page("worth")
    benefit_section(page, benefit(pair.robot(), pair.sweeps([0.0, 0.3, 0.6])))
    html = page.html()
    assert "Not judged: j1 has sweeps in 3 poses" in html
    assert "<figure>" not in html
