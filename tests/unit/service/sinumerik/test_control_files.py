"""Measurements of the control itself: what is in them, what they tell of the axis, and what is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service import BadInput
from service.cli.commands.imports import import_trace
from service.formats.sinumerik.document import (
    Given,
    MeasuredResponse,
    Size,
    measurement_document,
    response_table,
    tuning_document,
)
from service.formats.sinumerik.measurement import LoopMeasurement, SpeedController, measurement_of, tuning_of
from service.formats.sinumerik.members import LARGEST, decode, read_members
from tests.command import sweepid
from tests.control_file import DELAY, GAIN, INERTIA, TOTAL, Loop, base85, tuning_xml

REAL = "data/sinumerik/frequency-response-trace.xml"


def read(folder: Path, text: str) -> LoopMeasurement:
    path = folder / "loop.xml"
    path.write_text(text, encoding="latin-1")
    return measurement_of(read_members(path))


def document(folder: Path, loop: Loop, given: Given) -> MeasuredResponse:
    return measurement_document(read(folder, loop.xml()), given, "loop.xml")


def known(size: Size | None) -> Size:
    assert size is not None
    return size


def test_numbers_in_base_85() -> None:
    """By hand: 1.0 is the word 0x3ff00000, of digits 20, 46, 59, 55, 48, and a word of zero."""
    assert 0x3FF00000 == 20 * 85**4 + 46 * 85**3 + 59 * 85**2 + 55 * 85 + 48
    assert decode("kKXTM.", "x").tolist() == [1.0]
    assert decode(" kKXTM.\n\t..", "x").tolist() == [1.0, 0.0]
    values = np.random.default_rng(1).normal(size=300) * 10.0 ** np.linspace(-150, 13, 300)
    assert np.array_equal(decode(base85(values), "x"), values)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("kMGfN.kM", "incomplete"),
        ("kMGfN", "1 words of base 85 are not whole doubles"),
        ("kMGf%.", "a character that is not of the control's base 85"),
        ("~~~~~.", "2 words of base 85 are not whole doubles"),
        (base85(np.array([1.0, np.nan])), "number 1 is NaN"),
        (base85(np.array([-np.inf])), "number 0 is NaN"),
    ],
)
def test_torn_or_foreign_numbers_are_refused(text: str, reason: str) -> None:
    with pytest.raises(BadInput, match=f"a.xml m_ValueVector: .*{reason}"):
        decode(text, "a.xml m_ValueVector")


def test_a_hand_made_loop_gives_its_inertia(tmp_path: Path) -> None:
    found = document(tmp_path, Loop(), Given(GAIN)).inertia
    for way in found.values():
        value, std = known(way.motor_side).value, known(way.motor_side).std
        assert value == pytest.approx(INERTIA, rel=2e-3)  # the spectrum's frequencies are 0.15 % too high
        assert 0 < std < 0.01 * INERTIA
        assert way.delay == pytest.approx(DELAY, rel=0.02)
        assert way.converged
        assert known(way.axis_side).value == pytest.approx(INERTIA * 628.3185307**2, rel=2e-3)
    assert known(found["time_series"].motor_side).value == pytest.approx(INERTIA, rel=5e-4)
    geared = document(tmp_path, Loop(), Given(gain=GAIN, gear_ratio=100.0))
    assert known(geared.inertia["time_series"].axis_side).value == pytest.approx(1e4 * INERTIA, rel=1e-3)
    assert geared.motor_to_axis == 100.0


@pytest.mark.parametrize(
    ("loop", "given"),
    [(Loop(reset_time=0.02), Given(GAIN, 0.02)), (Loop(with_gain=True), Given())],
    ids=["an integral part without reference model", "the gain in the file"],
)
def test_other_controllers(loop: Loop, given: Given, tmp_path: Path) -> None:
    found = document(tmp_path, loop, given)
    assert known(found.inertia["time_series"].motor_side).value == pytest.approx(INERTIA, rel=1e-3)
    assert found.speed_controller_gain == GAIN


def test_without_the_gain_there_is_no_inertia_in_kilogram_square_metres(tmp_path: Path) -> None:
    found = document(tmp_path, Loop(), Given())
    assert found.inertia["spectrum"].motor_side is None
    assert known(found.inertia["spectrum"].over_gain).value == pytest.approx(INERTIA / GAIN, rel=2e-3)
    assert "p1460" in found.cannot_tell[0]
    assert found.unread == ("TimeSeries/m_TimeVector.start", "ResponseTestCondition/m_dOfTheNextVersion")


def test_a_tuning_file_gives_the_inertia_of_rotor_and_load(tmp_path: Path) -> None:
    path = tmp_path / "AST_AX7.xml"
    for seed in range(5):
        path.write_text(tuning_xml(seed=seed), encoding="latin-1")
        found = tuning_of(read_members(path))
        told = tuning_document(found, Given(), str(path))
        one = known(told.inertia["response"].motor_side)
        assert abs(one.value - TOTAL) < 3 * one.std
        assert one.std < 0.02 * TOTAL
    assert told.by_control.total_inertia == 0.14675
    assert told.speed_controllers == (SpeedController(gain=22.24, reset_time=0.035, reference_model=True),)
    table = response_table(found)
    assert np.abs(table["re"] + 1j * table["im"])[0] == pytest.approx(1 / abs(0.4 + 2j * np.pi * 0.5 * TOTAL), rel=0.05)
    assert (table["coherence"] > 0.99).all()


INTERVAL, LAUGHS = (
    'name="m_dSamplingInterval">0.000125<',
    "".join(f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(9)),
)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('ver="4.7.6.0.3"', 'ver="5.1.0.0.0"', "has version '5.1.0.0.0'; known are 4.7.x and 4.96.x"),
        ("ResponseTestCustom", "ResponseTestOther", "is a ResponseTestOther, not a ResponseTestCustom"),
        ('name="m_uPrbsOrder"', 'name="m_uOrder"', "has no member m_uPrbsOrder"),
        (INTERVAL, 'name="m_dSamplingInterval">nan<', "'nan', which is not a number below 1e+15"),
        (INTERVAL, 'name="m_dSamplingInterval">0.00025<', "samples, 0.00025 s apart"),
        ('name="m_uNodeId">61<', 'name="m_uNodeId">99<', "signal 99 of platform 5 is not known; known are the drive's"),
        ('name="m_eControlLoopType">2<', 'name="m_eControlLoopType">1<', "not measured of the speed control loop"),
        ('name="m_eWaveformType">4<', 'name="m_eWaveformType">1<', "not measured with pseudo-random noise"),
        ('name="m_length">127<', 'name="m_length">126<', "m_ValueVector has 127 numbers, and says 126 of 1"),
        ('name="m_uSignodeId">62<', 'name="m_uSignodeId">63<', "has no cross-spectrum with signal 62"),
        ("TimeSeries", "Series", "has no TimeSeries: save the measurement with its time series"),
        ("</ResponseTestCustom>", "", "is not a complete XML file"),
        ('name="m_bIsLinearMotor">false<', 'name="m_bIsLinearMotor">true<', "is of a linear motor"),
        ('name="m_GainValue_real">1<', 'name="m_GainValue_real">2<', "is distorted by"),
        ("<ResponseTest", f'<!DOCTYPE a [<!ENTITY a "ha">{LAUGHS}]>&j;<ResponseTest', "declares a DOCTYPE"),
        ("<ResponseTest", '<!DOCTYPE a [<!ENTITY a SYSTEM "file:///etc/passwd">]><ResponseTest', "declares a DOCTYPE"),
    ],
)
def test_what_is_missing_or_foreign_is_refused(tmp_path: Path, old: str, new: str, reason: str) -> None:
    text = Loop(order=7).xml()
    assert old in text
    with pytest.raises(BadInput, match=r"loop\.xml") as refusal:
        read(tmp_path, text.replace(old, new))
    assert reason in str(refusal.value)


def test_a_file_of_100_megabytes_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "large.xml"
    with path.open("wb") as file:
        file.truncate(100_000_000)
    with pytest.raises(BadInput, match=f"large.xml: is larger than {LARGEST} bytes"):
        measurement_of(read_members(path))


@pytest.mark.slow
@pytest.mark.parametrize("text", ["<a>" * 100 + "</a>" * 100, f"<a>{'<b/>' * 200_001}</a>"], ids=["deep", "many"])
def test_members_are_bounded(tmp_path: Path, text: str) -> None:
    with pytest.raises(BadInput, match="has more than 200000 members, or more than 64 inside of each other"):
        read(tmp_path, text)


def test_the_real_measurement_tells_the_same_by_series_and_spectrum(shared: Path) -> None:
    found = measurement_of(read_members(shared / REAL))
    told = measurement_document(found, Given(gain=0.8), REAL)
    series, spectrum = (known(told.inertia[way].motor_side) for way in ("time_series", "spectrum"))
    assert abs(series.value - spectrum.value) < min(series.std, spectrum.std)
    assert 0 < max(series.std, spectrum.std) < 0.05 * series.value
    assert told.excitation.offset_rpm == pytest.approx(4.0)
    assert told.excitation.sample_interval == 125e-6
    assert (told.input[:5], told.output[:5]) == ("r0062", "r0061")
    assert told.unread


def test_the_spectra_of_the_control_are_those_of_its_series(shared: Path) -> None:
    """To rounding, if the lines lie at multiples of 1/(n T): the frequencies in the file are 0.15 % too high."""
    found = measurement_of(read_members(shared / REAL))
    count, lines = len(found.output.series[0]), len(found.spectra.cross)
    pairs = zip(found.input.series, found.output.series, strict=True)
    crossed = [np.conj(np.fft.rfft(outward)) * np.fft.rfft(inward) for inward, outward in pairs]
    ours = np.mean(crossed, axis=0)[1:lines] * 4 / count**2
    np.testing.assert_allclose(found.spectra.cross[1:], ours, rtol=1e-9)
    assert found.axis_error == pytest.approx(2047 / 2044 - 1, rel=1e-6)
    assert (found.spectra.coherence <= 1 + 1e-9).all()


@pytest.mark.slow
def test_from_the_command_line(tmp_path: Path) -> None:
    path, out = tmp_path / "loop.xml", tmp_path / "tables"
    path.write_text(Loop().xml(), encoding="latin-1")
    told = sweepid("import", "trace", str(path), "--speed-gain", str(GAIN), "--out", str(out), "--json", "-")
    assert told.returncode == 0, told.stderr
    found = json.loads(told.stdout)
    assert found["inertia"]["time_series"]["motor_side"]["value"] == pytest.approx(INERTIA, rel=1e-3)
    assert "members not read: TimeSeries/m_TimeVector.start, ResponseTestCondition/m_dOfTheNextVersion" in told.stderr
    assert json.loads((out / "measurement.json").read_text()) == found
    assert np.loadtxt(out / "recording.csv", delimiter=",", skiprows=1).shape == (2047, 5)
    assert (out / "frequency_response.csv").read_text().startswith("frequency,re,im,coherence")


@pytest.mark.slow
def test_what_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "loop.xml"
    path.write_text(Loop().xml(), encoding="latin-1")
    import_trace(path)
    shown = capsys.readouterr().out
    assert "by time series: J/K = 3.62" in shown
    assert "not determined: inertia in kg m^2" in shown
    path.write_text(tuning_xml(), encoding="latin-1")
    import_trace(path)
    assert "the control's own: 0.1467 kg m^2, without uncertainty" in capsys.readouterr().out


def test_options_that_do_not_fit_the_file_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "loop.xml"
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "old").write_text("kept")
    path.write_text(tuning_xml(), encoding="latin-1")
    mapping = tmp_path / "mapping.yaml"
    refused: tuple[tuple[Path, dict[str, Any], str], ...] = (
        (path, {"out": tmp_path / "tables"}, "tables: is not empty"),
        (path, {"source": path}, r"--source: .* is the measurement itself, not a mapping"),
        (mapping, {"out": tmp_path / "b", "speed_gain": 1.0}, "--speed-gain: applies only to a measurement of a Sin"),
        (mapping, {}, "--out: is missing"),
    )
    for file, options, told in refused:
        with pytest.raises(BadInput, match=told):
            import_trace(file, **options)
