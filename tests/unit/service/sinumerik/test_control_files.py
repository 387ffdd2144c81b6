"""Measurements of the control itself: what is in them, what they tell of the axis, and what is refused."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from service.cli.commands.imports import import_control_file, import_trace
from service.formats.sinumerik.document import (
    Given,
    LoopInertia,
    Size,
    measurement_document,
    response_table,
    tuning_document,
)
from service.formats.sinumerik.measurement import (
    LoopMeasurement,
    SpeedController,
    measurement_of,
    tuning_of,
)
from service.formats.sinumerik.members import LARGEST, decode, read_members
from service.model.errors import BadInput
from tests.control_file import DELAY, GAIN, INERTIA, TOTAL, Loop, base85, tuning_xml

REAL = "data/sinumerik/frequency-response-trace.xml"


def read(folder: Path, text: str) -> LoopMeasurement:
    path = folder / "loop.xml"
    path.write_text(text, encoding="latin-1")
    return measurement_of(read_members(path))


def inertia(
    found: LoopMeasurement, gain: float | None = None, reset_time: float | None = None
) -> dict[str, LoopInertia]:
    return measurement_document(found, Given(gain, reset_time), "loop.xml").inertia


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
    found = inertia(read(tmp_path, Loop().xml()), GAIN)
    for way in found.values():
        value, std = known(way.motor_side).value, known(way.motor_side).std
        assert value == pytest.approx(INERTIA, rel=2e-3)  # the spectrum's frequencies are 0.15 % too high
        assert 0 < std < 0.01 * INERTIA
        assert way.delay == pytest.approx(DELAY, rel=0.02)
        assert way.converged
        assert known(way.axis_side).value == pytest.approx(INERTIA * 628.3185307**2, rel=2e-3)
    assert known(found["time_series"].motor_side).value == pytest.approx(INERTIA, rel=5e-4)
    document = measurement_document(read(tmp_path, Loop().xml()), Given(gain=GAIN, gear_ratio=100.0), "loop.xml")
    assert known(document.inertia["time_series"].axis_side).value == pytest.approx(1e4 * INERTIA, rel=1e-3)
    assert document.motor_to_axis == 100.0


def test_an_integral_part_without_reference_model_is_told_apart_by_its_reset_time(tmp_path: Path) -> None:
    found = read(tmp_path, Loop(reset_time=0.02).xml())
    assert known(inertia(found, GAIN, 0.02)["time_series"].motor_side).value == pytest.approx(INERTIA, rel=1e-3)


def test_without_the_gain_there_is_no_inertia_in_kilogram_square_metres(tmp_path: Path) -> None:
    document = measurement_document(read(tmp_path, Loop().xml()), Given(), "loop.xml")
    assert document.inertia["spectrum"].motor_side is None
    assert known(document.inertia["spectrum"].over_gain).value == pytest.approx(INERTIA / GAIN, rel=2e-3)
    assert "p1460" in document.cannot_tell[0]
    assert document.unread == ("TimeSeries/m_TimeVector.start", "ResponseTestCondition/m_dOfTheNextVersion")


def test_the_gain_in_the_file_is_taken(tmp_path: Path) -> None:
    document = measurement_document(read(tmp_path, Loop(with_gain=True).xml()), Given(), "loop.xml")
    assert known(document.inertia["time_series"].motor_side).value == pytest.approx(INERTIA, rel=1e-3)
    assert document.speed_controller_gain == GAIN


def test_a_tuning_file_gives_the_inertia_of_rotor_and_load(tmp_path: Path) -> None:
    path = tmp_path / "AST_AX7.xml"
    for seed in range(5):
        path.write_text(tuning_xml(seed=seed), encoding="latin-1")
        found = tuning_of(read_members(path))
        document = tuning_document(found, Given(), str(path))
        one = known(document.inertia["response"].motor_side)
        assert abs(one.value - TOTAL) < 3 * one.std
        assert one.std < 0.02 * TOTAL
    assert document.by_control.total_inertia == 0.14675
    assert document.speed_controllers == (SpeedController(gain=22.24, reset_time=0.035, reference_model=True),)
    table = response_table(found)
    assert np.abs(table["re"] + 1j * table["im"])[0] == pytest.approx(1 / abs(0.4 + 2j * np.pi * 0.5 * TOTAL), rel=0.05)
    assert (table["coherence"] > 0.99).all()


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('ver="4.7.6.0.3"', 'ver="5.1.0.0.0"', "has version '5.1.0.0.0'; known are 4.7.x and 4.96.x"),
        ("ResponseTestCustom", "ResponseTestOther", "is a ResponseTestOther, not a ResponseTestCustom"),
        ('name="m_uPrbsOrder"', 'name="m_uOrder"', "has no member m_uPrbsOrder"),
        (
            'name="m_dSamplingInterval">0.000125<',
            'name="m_dSamplingInterval">nan<',
            "'nan', which is not a number below 1e+15",
        ),
        ('name="m_dSamplingInterval">0.000125<', 'name="m_dSamplingInterval">0.00025<', "samples, 0.00025 s apart"),
        (
            'name="m_uNodeId">61<',
            'name="m_uNodeId">99<',
            "signal 99 of platform 5 is not known; known are the drive's r00",
        ),
        ('name="m_eControlLoopType">2<', 'name="m_eControlLoopType">1<', "not measured of the speed control loop"),
        ('name="m_eWaveformType">4<', 'name="m_eWaveformType">1<', "not measured with pseudo-random noise"),
        ('name="m_length">127<', 'name="m_length">126<', "m_ValueVector has 127 numbers, and says 126 of 1"),
        ('name="m_uSignodeId">62<', 'name="m_uSignodeId">63<', "has no cross-spectrum with signal 62"),
        ("TimeSeries", "Series", "has no TimeSeries: save the measurement with its time series"),
        ("</ResponseTestCustom>", "", "is not a complete XML file"),
        ('name="m_bIsLinearMotor">false<', 'name="m_bIsLinearMotor">true<', "is of a linear motor"),
        ('name="m_GainValue_real">1<', 'name="m_GainValue_real">2<', "is distorted by"),
    ],
)
def test_what_is_missing_or_foreign_is_refused(tmp_path: Path, old: str, new: str, reason: str) -> None:
    text = Loop(order=7).xml()
    assert old in text
    changed = text.replace(old, new)
    with pytest.raises(BadInput, match=r"loop\.xml") as refusal:
        read(tmp_path, changed)
    assert reason in str(refusal.value)


def test_a_billion_laughs_are_not_heard(tmp_path: Path) -> None:
    laughs = '<!DOCTYPE a [<!ENTITY a "ha">' + "".join(
        f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(9)
    )
    with pytest.raises(BadInput, match="declares a DOCTYPE"):
        read(tmp_path, f"{laughs}]><ResponseTestCustom>&j;</ResponseTestCustom>")
    outside = '<!DOCTYPE a [<!ENTITY a SYSTEM "file:///etc/passwd">]><ResponseTestCustom>&a;</ResponseTestCustom>'
    with pytest.raises(BadInput, match="declares a DOCTYPE"):
        read(tmp_path, outside)


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


@pytest.mark.slow
def test_mutated_files_are_read_or_refused_in_a_sentence(tmp_path: Path) -> None:
    """Values of other sizes, foreign characters, renamed and missing pieces: never anything but BadInput."""
    texts, values = [Loop(order=7).xml(), tuning_xml()], ["0", "-1", "1e308", "5e-324", "nan", "", "true", "9" * 30]
    random = np.random.default_rng(1)
    refused: list[str] = []
    for number in range(200):
        text = texts[number % 2]
        place = int(random.integers(len(text) - 400))
        kind = number % 5
        if kind < 2:
            held = list(re.finditer(r">([^<>]{1,30})<", text))
            one = held[int(random.integers(len(held)))]
            text = text[: one.start(1)] + values[int(random.integers(len(values)))] + text[one.end(1) :]
        elif kind == 2:
            text = text[:place] + chr(int(random.integers(32, 256))) + text[place + 1 :]
        elif kind == 3:
            text = text[:place] + text[place + int(random.integers(1, 400)) :]
        else:
            names = re.findall(r'name="(\w+)"', text)
            text = text.replace(f'"{names[int(random.integers(len(names)))]}"', '"m_other"')
        path = tmp_path / "mutated.xml"
        path.write_text(text, encoding="latin-1")
        try:
            import_control_file(path, Given(gain=GAIN), None, str(tmp_path / "out.json"))
        except BadInput as refusal:
            refused.append(str(refusal))
    assert 100 < len(refused) < 200
    assert all("mutated.xml" in sentence for sentence in refused)


def test_the_real_measurement_tells_the_same_by_series_and_spectrum(shared: Path) -> None:
    found = measurement_of(read_members(shared / REAL))
    document = measurement_document(found, Given(gain=0.8), REAL)
    series, spectrum = (known(document.inertia[way].motor_side) for way in ("time_series", "spectrum"))
    print(f"J at K = 0.8: {series.value:.6f} +- {series.std:.6f}, {spectrum.value:.6f} +- {spectrum.std:.6f}")
    assert abs(series.value - spectrum.value) < min(series.std, spectrum.std)
    assert 0 < max(series.std, spectrum.std) < 0.05 * series.value
    assert document.excitation.offset_rpm == pytest.approx(4.0)
    assert document.excitation.sample_interval == 125e-6
    assert (document.input[:5], document.output[:5]) == ("r0062", "r0061")
    assert document.unread


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
    command = [str(Path(sys.executable).with_name("sweepid")), "import", "trace", str(path), "--speed-gain", str(GAIN)]
    told = subprocess.run([*command, "--out", str(out), "--json", "-"], capture_output=True, text=True, timeout=120)
    assert told.returncode == 0, told.stderr
    document = json.loads(told.stdout)
    assert document["inertia"]["time_series"]["motor_side"]["value"] == pytest.approx(INERTIA, rel=1e-3)
    assert "members not read: TimeSeries/m_TimeVector.start, ResponseTestCondition/m_dOfTheNextVersion" in told.stderr
    assert json.loads((out / "measurement.json").read_text()) == document
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
    with pytest.raises(BadInput, match="tables: is not empty"):
        import_trace(path, out=tmp_path / "tables")
    with pytest.raises(BadInput, match=r"--source: .* is the measurement itself, not a mapping"):
        import_trace(path, source=path)
    with pytest.raises(BadInput, match="--speed-gain: applies only to a measurement of a Sinumerik"):
        import_trace(tmp_path / "mapping.yaml", out=tmp_path / "b", speed_gain=1.0)
    with pytest.raises(BadInput, match="--out: is missing"):
        import_trace(tmp_path / "mapping.yaml")
