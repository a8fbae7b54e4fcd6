"""Whether the parts of the guide to build an instrument fit: ``python docs/parts.py``.

Each figure of a data sheet stands here once, beside those of ``uuv_array budget`` and of the
firmware's header, from which the rest is computed. The schematic draws the same figures.

As commonly quoted, from sheets that we could not check: the LED's flux; swing, offset, bias and
output resistance of OPA376; BPW34's capacitance; that of the cable; all of LP5907, MAX3485E and
Teensy 4.1.
"""

import math
import re
from pathlib import Path
from typing import NamedTuple

from uuv_optical_array import ForwardModel, load_scene
from uuv_optical_array.forward.link_budget import Instrument, scene_with

IT = Instrument()
HEADER = Path(__file__).parents[1] / "examples/array_firmware.h"
FIRMWARE = {
    name: int(value)
    for name, value in re.findall(r"#define FIRMWARE_(\w+) (\d+)", HEADER.read_text("utf-8"))
}

# Supply: a battery of four lithium cells, V, and what is made of it.
BUS_V, LOGIC_V, ANALOG_V = (12.0, 16.8), 5.0, 3.3
WATER_C, IN_HOUSING_C = 30.0, 45.0  # the warmest
# LED L1C1-GRN1000000000: Lumileds DS144, tables 3 and 4. Its flux is to be read from the sheet of
# the lot; twice the current of the bin, 350 mA, gives some 1.6 times the light of a green LED.
# At 700 mA its voltage is some 0.3 V above that at 350 mA.
LED_MOST_A, LED_V, LED_MOST_C, LED_K_PER_W = 1.05, (2.5, 3.5 + 0.3), 135.0, 3.5
LED_BIN_A, LED_BIN_LM, LED_GAIN, EYE = 0.35, 116.0, 1.6, 0.79
BOARD_K_PER_W, WALL_K_PER_W = 5.0, 5.0  # star board with paste, and a wall of aluminium: estimated
# Driver LDD-700H: Mean Well LDD-H, sheet of 2018.
DRIVER_A, DRIVER_ERROR, DRIVER_IN_V, DRIVER_OUT_V, DRIVER_DROP_V = 0.7, 0.04, (9, 56), (2, 52), 3.0
# Photodiode BPW34: Vishay 81521. Its capacitance at 0 V, and that of the amplifier's input.
DIODE_F, INPUT_F = 70e-12, 10e-12
# Amplifier OPA376: Texas Instruments SBOS406G. Common mode up to 1.3 V below the supply.
AMPLIFIER_V, AMPLIFIER_HZ, AMPLIFIER_A, SWING_V, COMMON_V = (2.2, 5.5), 5.5e6, 0.95e-3, 0.02, 1.3
OFFSET_V, BIAS_A, SHUNT_OHM = 25e-6, 10e-12, 1e9
# What it drives without a resistor as a follower (that of its sibling OPA377, SBOS504B), the
# resistor that its sheet names for more, and what its own output has at most.
LOAD_F, SERIES_OHM, OUTPUT_OHM = 250e-12, (10.0, 20.0), 1e3
# A row's cable: the capacitance of a core to all others.
CABLE_F_PER_M, CABLE_M = 100e-12, 1.0
# Around it: the reference of all channels, the feedback, and the filter before the converter. The
# reference goes by a resistor to its capacitor, from there to discs and converters.
DIVIDER_OHM, FEEDBACK_F, FILTER_OHM, FILTER_F = (64.9e3, 1e3), 10e-12, 1e3, 1e-9
REFERENCE_OHM, REFERENCE_F = 20.0, 10e-6
REFERENCE_V = ANALOG_V * DIVIDER_OHM[1] / sum(DIVIDER_OHM)
# Converter ADS131M08: Texas Instruments SBAS950B; noise by table 7-1 of the family (gain 1).
CONVERTER_V, CONVERTER_IN_V, CONVERTER_MHZ = (2.7, 3.6), (-1.3, ANALOG_V), (0.3, 8.4)
CONVERTER_OHM, CONVERTER_A, SPI_MOST_HZ = 330e3, 10e-3, 25e6
CONVERTER_NOISE_V = {250: 1.90e-6, 4000: 5.35e-6, 32000: 21.31e-6}  # by samples a second
CLOCK_HZ, CLOCK_A, OVERSAMPLING = 8.192e6, 15e-3, 1024
# Regulators LP5907-3.3 (SNVS798) and TSR 1-2450 (Traco).
LDO_IN_V, LDO_A, LDO_K_PER_W, LDO_MOST_C = (2.2, 5.5), 0.25, 193.0, 125.0
STEP_IN_V, STEP_A = (6.5, 36.0), 1.0
# Teensy 4.1 (PJRC) at 600 MHz, and MAX3485E (Maxim 19-3290) on a line of 54 ohm.
BOARD_V, BOARD_A, BOARD_OUT_A, SPI_HZ, BAUD = (3.6, 5.5), 0.1, 0.25, 15e6, 921_600
LINE_BAUD, LINE_A = 12e6, 3.3 / 54
CORES, CORES_FOR_ALL = 8, 3  # of a row's cable; of them supply, ground and reference


class Check(NamedTuple):
    """A figure, and the least and the most that it may be."""

    what: str
    value: float
    low: float
    high: float
    unit: str

    @property
    def fits(self) -> bool:
        """Whether it is within its bounds."""
        rounding = 1e-9 * abs(self.value)
        return self.low - rounding <= self.value <= self.high + rounding


def led_heat_w() -> float:
    """Return the heat of the LED, W: what its largest voltage brings, less the light."""
    return DRIVER_A * LED_V[1] - IT.lamp_w


def feedback_least_f() -> float:
    """Return the least feedback capacitance that keeps the amplifier stable, F.

    Graeme 1996, Photodiode Amplifiers, chapter 4.
    """
    capacitance = DIODE_F + INPUT_F
    return math.sqrt(capacitance / (2 * math.pi * IT.feedback_ohm * AMPLIFIER_HZ))


def noise_density_v(samples_per_s: int) -> float:
    """Return the converter's noise, V/sqrt(Hz), by its table.

    The noise bandwidth of a sinc filter of third order is 0.275 of its rate. Below 4,000 samples a
    second the filter averages those of 4,000, which leaves half of the rate.
    """
    share = 0.275 if samples_per_s >= 4000 else 0.5
    return CONVERTER_NOISE_V[samples_per_s] / math.sqrt(share * samples_per_s)


def checks() -> list[Check]:
    """Return every figure with its bounds."""
    none, count_v = math.inf, IT.full_scale_v / 2**IT.bits
    top_v = REFERENCE_V + IT.full_scale_v
    analog_a = 26 * AMPLIFIER_A + 4 * CONVERTER_A + CLOCK_A
    offset_v = OFFSET_V * (1 + IT.feedback_ohm / SHUNT_OHM) + BIAS_A * IT.feedback_ohm
    frame = 30 * 8 * FIRMWARE["CONVERTERS"] / SPI_HZ
    band_hz = 1 / (2 * math.pi * IT.feedback_ohm * FEEDBACK_F)
    filter_hz = 1 / (2 * math.pi * FILTER_OHM * FILTER_F)
    detectors = FIRMWARE["SIDE"] ** 2
    held_hz = 1 / (2 * math.pi * REFERENCE_OHM * REFERENCE_F)
    crossed_hz = AMPLIFIER_HZ * REFERENCE_OHM / (REFERENCE_OHM + OUTPUT_OHM)
    # Photodiodes and converters lead their currents into the reference.
    sunk_a = detectors * IT.full_scale_v * (1 / IT.feedback_ohm + 1 / CONVERTER_OHM)
    scans = FIRMWARE["SCANS_PER_S"]
    packet_bits = 10 * (14 + 2 * FIRMWARE["SIDE"] ** 2 + 4 + 2)  # a byte has ten on the line
    flux_lm = IT.lamp_w * 683 * EYE
    model = ForwardModel(scene_with(load_scene("follow"), IT))
    nearest = float(model.light([-3.0, 0, 0, 0, 0]).max())
    return [
        Check("LED: current, driver at its upper tolerance", DRIVER_A * (1 + DRIVER_ERROR),
              0, LED_MOST_A, "A"),
        Check("LED: junction in the warmest water", WATER_C + led_heat_w()
              * (LED_K_PER_W + BOARD_K_PER_W + WALL_K_PER_W), 0, LED_MOST_C, "deg C"),
        Check("LED: flux of its bin at 700 mA", LED_BIN_LM * LED_GAIN, flux_lm, none, "lm"),
        Check("driver: least supply", BUS_V[0], DRIVER_IN_V[0], none, "V"),
        Check("driver: largest supply", BUS_V[1], 0, DRIVER_IN_V[1], "V"),
        Check("driver: largest voltage of the LED", LED_V[1], DRIVER_OUT_V[0],
              min(DRIVER_OUT_V[1], BUS_V[0] - DRIVER_DROP_V), "V"),
        Check("amplifier: reference above what its output reaches", REFERENCE_V, SWING_V,
              ANALOG_V - COMMON_V, "V"),
        Check("amplifier: output at full scale", top_v, 0, ANALOG_V - SWING_V, "V"),
        Check("amplifier: supply", ANALOG_V, *AMPLIFIER_V, "V"),
        Check("amplifier: capacitance at its input", 1e12 * (DIODE_F + INPUT_F), 0,
              1e12 * IT.capacitance_f, "pF"),
        Check("amplifier: feedback capacitance", 1e12 * FEEDBACK_F, 1e12 * feedback_least_f(),
              none, "pF"),
        Check("amplifier: band, for carriers up to 2 kHz", band_hz / 1e3, 10, none, "kHz"),
        Check("amplifier: offset in counts, a tenth of the pedestal", offset_v / count_v, 0,
              IT.pedestal_counts / 10, "counts"),
        Check("amplifier: capacitance of its cable", 1e12 * CABLE_F_PER_M * CABLE_M, 0,
              1e12 * LOAD_F, "pF"),
        Check("reference: resistor between amplifier and load", REFERENCE_OHM, *SERIES_OHM, "ohm"),
        Check("reference: corner of resistor and capacitor", held_hz / 1e3, 0, crossed_hz / 10e3,
              "kHz"),
        Check("reference: load beside its capacitor, a tenth of it", 1e9 * detectors
              * (DIODE_F + INPUT_F + FILTER_F) + 1e9 * 5 * CABLE_F_PER_M * CABLE_M, 0,
              1e8 * REFERENCE_F, "nF"),
        Check("reference: rise at full scale, common to all", 1e3 * sunk_a * REFERENCE_OHM, 0,
              1e3 * REFERENCE_V / 10, "mV"),
        Check("converter: input at full scale", top_v, *CONVERTER_IN_V, "V"),
        Check("converter: supply", ANALOG_V, *CONVERTER_V, "V"),
        Check("converter: clock", CLOCK_HZ / 1e6, *CONVERTER_MHZ, "MHz"),
        Check("converter: samples a second", CLOCK_HZ / 2 / OVERSAMPLING, scans, scans, "1/s"),
        Check("converter: bits to drop for one sign and the reading's", 24 - 1 - IT.bits,
              FIRMWARE["SHIFT"], FIRMWARE["SHIFT"], ""),
        Check("converter: noise near the band of a reading", 1e6 * noise_density_v(250), 0,
              1e6 * IT.converter_v_per_rthz, "uV/sqrt(Hz)"),
        Check("converter: corner of the filter before it", filter_hz / 1e3, 2e-3 * band_hz,
              CLOCK_HZ / 2 / 20e3, "kHz"),
        Check("converter: gain lost in the filter's resistor", FILTER_OHM / CONVERTER_OHM, 0, 0.01,
              ""),
        Check("inputs for the detectors", FIRMWARE["CONVERTERS"] * FIRMWARE["CHANNELS"],
              FIRMWARE["SIDE"] ** 2, none, ""),
        Check("cores for a row", FIRMWARE["SIDE"] + CORES_FOR_ALL, 0, CORES, ""),
        Check("reading: counts at 3 m", nearest, 0, 2**IT.bits - 1, "counts"),
        Check("reading: time that it averages", FIRMWARE["EXPOSURE"] / scans, IT.average_s,
              IT.average_s, "s"),
        Check("reading: pedestal of firmware and budget", FIRMWARE["PEDESTAL"],
              IT.pedestal_counts, IT.pedestal_counts, "counts"),
        Check("SPI: clock", SPI_HZ / 1e6, 0, SPI_MOST_HZ / 1e6, "MHz"),
        Check("SPI: time of a scan, half of its period", 1e6 * frame, 0, 0.5e6 / scans, "us"),
        Check("line: rate", BAUD / 1e6, 0, LINE_BAUD / 1e6, "Mbit/s"),
        Check("line: time of a frame, half of its period", 1e3 * packet_bits / BAUD, 0,
              500 * FIRMWARE["PERIOD"] / scans, "ms"),
        Check("3.3 V: current", analog_a, 0, LDO_A, "A"),
        Check("3.3 V: regulator's input", LOGIC_V, *LDO_IN_V, "V"),
        Check("3.3 V: regulator's junction", IN_HOUSING_C + LDO_K_PER_W * analog_a
              * (LOGIC_V - ANALOG_V), 0, LDO_MOST_C, "deg C"),
        Check("5 V: current", analog_a + BOARD_A + LINE_A, 0, STEP_A, "A"),
        Check("microcontroller: current from its 3.3 V", LINE_A + 4 * CONVERTER_A, 0,
              BOARD_OUT_A, "A"),
        Check("5 V: microcontroller's supply", LOGIC_V, *BOARD_V, "V"),
        Check("5 V: regulator's least supply", BUS_V[0], STEP_IN_V[0], none, "V"),
        Check("5 V: regulator's largest supply", BUS_V[1], 0, STEP_IN_V[1], "V"),
    ]  # fmt: skip


def report() -> str:
    """Return the checks as text."""
    lines = [f"{'what':<60}{'is':>10}{'least':>9}{'most':>9}"]
    for check in checks():
        bounds = [f"{bound:9.4g}" if math.isfinite(bound) else f"{'':9}" for bound in check[2:4]]
        verdict = "" if check.fits else "  DOES NOT FIT"
        lines.append(f"{check.what:<60}{check.value:10.4g}{''.join(bounds)} {check.unit}{verdict}")
    return "\n".join(lines)


if __name__ == "__main__":
    print(report())
