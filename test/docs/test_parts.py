"""The parts of the guide fit each other, and guide, schematic and firmware name the same ones."""

import math
import re
from xml.etree import ElementTree

import numpy as np
import parts
import parts_list
import pytest
from generate_reference import drawing
from pages import ROOT

GUIDE = (ROOT / "docs/how_to/build_instrument.md").read_text(encoding="utf-8")
WHY = (ROOT / "docs/explanation/instrument.md").read_text(encoding="utf-8")
BOARD = (ROOT / "examples/teensy41_board.cpp").read_text(encoding="utf-8")


def named(what):
    (check,) = [check for check in parts.checks() if check.what == what]
    return check


def test_every_part_is_within_its_limits():
    assert [check for check in parts.checks() if not check.fits] == []


@pytest.mark.parametrize(
    ("figure", "value", "what"),
    [
        ("LED_MOST_A", 0.5, "LED: current, driver at its upper tolerance"),
        ("LED_BIN_LM", 74.0, "LED: flux of its bin at 700 mA"),
        ("DRIVER_A", 1.4, "LED: current, driver at its upper tolerance"),
        ("BUS_V", (5.0, 8.4), "driver: largest voltage of the LED"),
        ("REFERENCE_V", 0.0, "amplifier: reference above what its output reaches"),
        ("ANALOG_V", 1.1, "amplifier: output at full scale"),
        ("FEEDBACK_F", 1e-12, "amplifier: feedback capacitance"),
        ("FEEDBACK_F", 100e-12, "amplifier: band, for carriers up to 2 kHz"),
        ("OFFSET_V", 5e-3, "amplifier: offset in counts, a tenth of the pedestal"),
        ("CABLE_M", 5.0, "amplifier: capacitance of its cable"),
        ("REFERENCE_OHM", 5.0, "reference: resistor between amplifier and load"),
        ("REFERENCE_OHM", 200.0, "reference: rise at full scale, common to all"),
        ("REFERENCE_F", 100e-9, "reference: corner of resistor and capacitor"),
        ("CONVERTER_NOISE_V", {250: 7e-6}, "converter: noise near the band of a reading"),
        ("FILTER_OHM", 33e3, "converter: gain lost in the filter's resistor"),
        ("SPI_HZ", 4e6, "SPI: time of a scan, half of its period"),
        ("CORES", 7, "cores for a row"),
    ],
)
def test_a_part_that_does_not_fit_is_told(figure, value, what, monkeypatch):
    """Among them the LED of 500 mA at a driver of 700, and an amplifier that rests at ground."""
    monkeypatch.setattr(parts, figure, value)
    assert not named(what).fits
    assert re.search(rf"^{re.escape(what)} .*DOES NOT FIT$", parts.report(), re.MULTILINE)


def test_figures_are_those_of_closed_forms():
    """Each written out anew, in the units of the sheets."""
    assert named("LED: junction in the warmest water").value == pytest.approx(
        30 + (0.7 * 3.8 - 0.33) * (3.5 + 5 + 5)
    )
    assert named("LED: flux of its bin at 700 mA").low == pytest.approx(0.33 * 683 * 0.79)
    assert named("amplifier: feedback capacitance").low == pytest.approx(
        1e12 * math.sqrt(80e-12 / (2 * math.pi * 1e6 * 5.5e6))
    )
    assert named("amplifier: band, for carriers up to 2 kHz").value == pytest.approx(
        1e-3 / (2 * math.pi * 1e6 * 10e-12)
    )
    reference_mv = 1e3 * parts.REFERENCE_V
    assert reference_mv == pytest.approx(3300 / 65.9)
    # A sinc filter of third order: the sum of squares of its weights, over the square of their sum.
    weights = np.convolve(np.convolve(np.ones(64), np.ones(64)), np.ones(64))
    share = np.square(weights).sum() / weights.sum() ** 2 * 64 / 2
    assert share == pytest.approx(0.275, rel=2e-3)
    for rate, told in ((250, 0.170), (4000, 0.161), (32000, 0.227)):
        assert 1e6 * parts.noise_density_v(rate) == pytest.approx(told, rel=5e-3)
    frame = 14 + 2 * 25 + 4 + 2  # bytes, with what the framing adds
    assert named("line: time of a frame, half of its period").value == pytest.approx(
        1e3 * 10 * frame / 921600
    )
    assert named("SPI: time of a scan, half of its period").value == pytest.approx(4 * 240 / 15)


def test_the_amplifier_of_the_reference_is_stable():
    """By the phase of its loop, whatever its own output has up to the figure that is taken."""
    held_ohm, held_f = parts.REFERENCE_OHM, parts.REFERENCE_F
    hz = np.geomspace(1, 1e8, 200001)
    s = 2j * np.pi * hz
    for own_ohm in (10.0, 150.0, parts.OUTPUT_OHM):
        load = held_ohm + 1 / (s * held_f)
        loop = parts.AMPLIFIER_HZ / (1j * hz) * load / (load + own_ohm)
        crossed = np.flatnonzero(np.abs(loop) < 1)[0]
        assert 180 + np.degrees(np.angle(loop[crossed])) > 80
    # Without the resistor, what the discs and cables load it with leaves next to no margin.
    bare_f = 25 * (parts.DIODE_F + parts.INPUT_F) + 5 * parts.CABLE_F_PER_M * parts.CABLE_M
    assert bare_f > 8 * parts.LOAD_F
    loop = parts.AMPLIFIER_HZ / (1j * hz) / (1 + s * bare_f * 150)
    crossed = np.flatnonzero(np.abs(loop) < 1)[0]
    assert 180 + np.degrees(np.angle(loop[crossed])) < 30
    sunk = 25 * (1.2e-6 + 1.2 / 330e3)  # A
    rise = named("reference: rise at full scale, common to all").value
    assert rise == pytest.approx(1e3 * sunk * held_ohm)


def test_what_is_drawn_and_told_beside_the_parts_is_ordered():
    """Values of resistors and capacitors, and what the steps of building use."""
    whats = " ".join(part.what for group in parts_list.PARTS.values() for part in group)
    drawn = ElementTree.fromstring(drawing("schematic.svg")).itertext()
    values = set(re.findall(r"\b[\d.]+ (?:MOhm|kOhm|ohm|pF|nF|uF)\b", " ".join(drawn)))
    assert len(values) == 7
    for value in values:
        number, unit = value.split()
        assert re.search(rf"\b{re.escape(number)}\b[\w ,.]*\b{unit}\b", whats), value
    for thing in ("120", "red LED", "paste", "glue", "dowels", "torch", "black cloth", "pool"):
        assert thing in whats, thing


def test_the_budget_has_the_figures_of_the_parts():
    it = parts.IT
    assert it.capacitance_f == pytest.approx(parts.DIODE_F + parts.INPUT_F)
    assert it.pedestal_counts == parts.FIRMWARE["PEDESTAL"]
    assert it.full_scale_v == 1.2  # the converter's own reference
    assert it.bits + parts.FIRMWARE["SHIFT"] + 1 == 24


def test_guide_and_schematic_name_the_parts_that_are_ordered():
    orders = [part.order for group in parts_list.PARTS.values() for part in group]
    drawn = ElementTree.fromstring(drawing("schematic.svg")).itertext()
    drawn = " ".join("".join(drawn).split())
    for name in ("LDD-700H", "BPW34", "OPA376", "ADS131M08", "TSR 1-2450", "Teensy 4.1"):
        assert any(name in order for order in orders), name
        assert name in drawn, name
    for name in ("LP5907", "MAX3485E"):
        assert any(name in order for order in orders), name
        assert name in GUIDE, name
        assert name in drawn, name
    assert "L1C1-GRN1" in drawn
    for text in (f"REF {1e3 * parts.REFERENCE_V:.0f} mV", "64.9 kOhm", "10 pF: 16 kHz", "1 nF"):
        assert text in drawn, text
    for text in (parts_list.parts_list(), parts.report()):
        lines = [line.rstrip() for line in text.splitlines()]
        assert "\n".join(lines) in GUIDE, "fill the guide by docs/fill_page.py"


def test_the_pins_of_the_guide_are_those_of_the_board():
    select = re.search(r"SELECT\[\w+\] = \{([\d, ]+)\}", BOARD).group(1)
    assert f"| {select} | `CS` of U1, U2, U3, U4 |" in GUIDE
    for name, goes in (("READY", "`DRDY`"), ("RESET", "`SYNC/RESET`"), ("FAULT", "a red LED")):
        pin = re.search(rf"uint8_t {name} = (\d+);", BOARD).group(1)
        assert f"| {pin} | {goes}" in GUIDE
    drive = re.search(r"uint8_t DRIVE = (\d+);", BOARD).group(1)
    assert f"| 1, {drive} | `DI` and `DE` of the MAX3485E" in GUIDE
    assert f"BAUD = {parts.BAUD}" in BOARD
    assert f"SPI_HZ = {parts.SPI_HZ:.0f}" in BOARD


def test_the_pages_say_the_pedestal_and_the_lamp_of_the_budget():
    assert f"**Darkness reads {parts.IT.pedestal_counts} counts**" in GUIDE
    assert f"level_counts: {parts.IT.pedestal_counts:.1f}" in WHY
    assert f"lamp: {parts.IT.lamp_w:g} W in a beam" in WHY
