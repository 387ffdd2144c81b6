"""Each word of the pages stands in the catalogue of each language, and nowhere else."""

import re
from typing import get_args

import pytest

from drivers.errors import CauseCode
from drivers.ports import AxisState
from service.data_check.finding import Code, Severity
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.experiments import FULL_DESIGN, MORE_POSES, TEST_MASS, WARM_UP
from service.identification.design.diagnosis_sweeps import BLOCKS
from service.model.results.diagnosis import Verdict
from service.process.settings import Settings
from service.store.access import Role
from service.store.documents import CampaignState, DiagnosisState
from service.web.app import create_app
from service.web.hmi.pages import texts
from tests.unit.service.hmi.page_words import DOCUMENTS, SCRIPTS, literals, named, read, words

TEXTS = texts()
KEYS = set(TEXTS["en"])
PLURAL = re.compile(r"\.(one|other)$")
STEMS = {PLURAL.sub("", key) for key in KEYS}
# the codes of the service that have a word in each language
FAMILIES = {
    "campaign-state": {state.value for state in CampaignState},
    "axis-state": {state.value for state in AxisState},
    "statement": {"moves", "energised", "stands", "unknown"},
    "statement-of": {"moves", "energised", "unknown"},
    "diagnosis-state": {state.value for state in DiagnosisState},
    "verdict": set(get_args(Verdict)),
    "severity": set(get_args(Severity)),
    "role": {role.word for role in Role},
    "block": {"sweep", "forward", "backward", *BLOCKS, FULL_DESIGN, MORE_POSES, TEST_MASS, WARM_UP},
    "effect": set(CATALOGUE),
    "effect-told": set(CATALOGUE),
    "finding": set(get_args(Code)),
    "column": {"pose", "axis", "block", "sweeps", "from", "goes", "speed", "time"},
    "pose-state": {"chosen", "free", "no_room", "collides"},
    "cause": set(CauseCode),
    "step": set(CauseCode),
    "payload-step": {"plan", "bare", "mount", "loaded", "result"},
    "payload-next": {"plan", "bare", "mount", "waiting", "compute", "computing", "done", "failed"},
    "payload-run": {state.value for state in CampaignState} - {"completed", "aborted"},
    "figure": {"map", "gap_by_pose", "example", "evidence", "parameters"},
}
OPEN_FAMILIES = (
    "done",
    "input",
    "parameter",
    "problem",
    "said",
)  # what has no word there is shown as the service has it
# of a script that are no words: what the service stores of a stop, classes, units, names and routes
NO_WORDS = {
    "api.js": {"Bearer"},
    "app.js": {"badge"},
    "causes.js": {"host watch", "operator page", "stop button"},
    "commands.js": {"POST /campaigns/{campaign_id}/"},
    "diagnosis.js": {"badge", "verdict"},
    "elements.js": {"min"},
    "findings.js": {"finding"},
    "payload.js": {"badge", "kg m²", "verdict"},
    "results.js": {"badge"},
    "machine.js": {"state", "state bad"},
    "login.js": {"not authenticated"},
    "stop.js": {"banner"},
    "words.js": {"Coulomb", "Stribeck", "mm"},
}


def placeholders(text: str) -> set[str]:
    return set(re.findall(r"\{(\w+)\}", text))


def test_english_is_first_and_there_is_german() -> None:
    assert list(TEXTS) == ["en", "de"]


@pytest.mark.parametrize("language", TEXTS)
def test_each_language_has_each_text(language: str) -> None:
    assert set(TEXTS[language]) == KEYS
    assert [key for key, text in TEXTS[language].items() if not text.strip()] == []


@pytest.mark.parametrize("language", TEXTS)
def test_each_language_has_the_same_placeholders(language: str) -> None:
    other = {key: text for key, text in TEXTS[language].items() if placeholders(text) != placeholders(TEXTS["en"][key])}
    assert other == {}


def test_a_text_that_counts_has_one_and_many() -> None:
    counting = {PLURAL.sub("", key) for key in KEYS if PLURAL.search(key)}
    assert {f"{stem}.{form}" for stem in counting for form in ("one", "other")} - KEYS == set()


@pytest.mark.parametrize("family", FAMILIES)
def test_each_code_of_the_service_has_its_word(family: str) -> None:
    assert {key.removeprefix(f"{family}.") for key in KEYS if key.startswith(f"{family}.")} == FAMILIES[family]


def test_an_effect_is_told_as_the_service_tells_it() -> None:
    told = {name: TEXTS["en"][f"effect-told.{name}"] for name in CATALOGUE}
    assert told == {name: effect.sentence for name, effect in CATALOGUE.items()}


PERMISSIONS = create_app(Settings()).state.permissions.roles


def test_what_was_done_is_a_command_of_the_api() -> None:
    done = {key.removeprefix("done.") for key in KEYS if key.startswith("done.")}
    assert done - {f"{method} {path.removeprefix('/api/v1')}" for method, path in PERMISSIONS} == {"stop"}  # an event


def test_each_command_of_the_audit_has_its_word() -> None:
    """The audit has every request but those that only read; the live plots are no command."""
    commands = {f"{method} {path.removeprefix('/api/v1')}" for method, path in PERMISSIONS if method == "POST"}
    assert {one for one in commands if f"done.{one}" not in KEYS} == set()


def test_each_text_that_is_asked_for_is_there_and_none_is_unused() -> None:
    asked = {key for script in SCRIPTS.values() for key in named(script)}
    asked |= {key for document in DOCUMENTS.values() for key in read(document).keys}
    assert asked - STEMS == set()
    written = {text for script in SCRIPTS.values() for text in literals(script)}
    by_code = (*FAMILIES, *OPEN_FAMILIES)
    assert {key for key in STEMS - asked - written if not key.startswith(tuple(f"{one}." for one in by_code))} == set()


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_document_has_no_words_of_its_own(name: str) -> None:
    assert read(DOCUMENTS[name]).words == []


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_has_no_words_of_its_own(name: str) -> None:
    assert set(words(SCRIPTS[name])) - NO_WORDS.get(name, set()) == set()


@pytest.mark.parametrize(
    "planted",
    ['tell("machine", "connected");', "x = `campaign ${id} runs`;", 'const TITLE = "Not so";', 'element("p", `none`)'],
)
def test_a_word_that_is_planted_is_found(planted: str) -> None:
    assert words(planted)
    assert read('<p title="Look">Start</p>').words == ["title=Look", "Start"]
