"""The schematic of lamp, one channel and converter, as SVG, for ``docs/generate_reference.py``.

Its values are the defaults of ``uuv_array budget`` and those of ``parts.py``.
"""

import math

import parts as fitted
from drawings import GREY, INK, arrow, dot, line, picture, words

IT = fitted.IT
REFERENCE = f"REF {1e3 * fitted.REFERENCE_V:.0f} mV"


def box(x: float, y: float, width: float, height: float, *texts: str) -> list[str]:
    """Return a box with lines of text in its middle."""
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    first = y + height / 2 + 5 - 9.5 * (len(texts) - 1)
    middle = {"text_anchor": "middle", "font_size": 14}
    return [
        line(corners, True, fill="#f4f4f4"),
        *(words(x + width / 2, first + 19 * i, text, **middle) for i, text in enumerate(texts)),
    ]


def resistor(x: float, y: float, text: str) -> list[str]:
    """Return a resistor that lies, from x to x + 60."""
    corners = [(x + 10, y - 7), (x + 50, y - 7), (x + 50, y + 7), (x + 10, y + 7)]
    return [
        line([(x, y), (x + 60, y)]),
        line(corners, True, fill="white"),
        words(x + 30, y - 13, text, text_anchor="middle", font_size=13),
    ]


def ground(x: float, y: float) -> list[str]:
    """Return the sign of ground below a point."""
    return [line([(x - 10 + 4 * i, y + 5 * i), (x + 10 - 4 * i, y + 5 * i)]) for i in range(3)]


def capacitor(x: float, y: float, upright: bool) -> list[str]:
    """Return the plates of a capacitor about a point, without its wires."""
    plate = 11
    if upright:
        return [line([(x - plate, y + d), (x + plate, y + d)], stroke_width=2) for d in (-3, 3)]
    return [line([(x + d, y - plate), (x + d, y + plate)], stroke_width=2) for d in (-3, 3)]


def diode(x: float, y: float, light: bool) -> list[str]:
    """Return an upright diode with its cathode at the top; light falls on it, or leaves it."""
    parts = [
        line([(x - 11, y + 10), (x + 11, y + 10), (x, y - 9)], True, fill="white"),
        line([(x - 11, y - 9), (x + 11, y - 9)], stroke_width=2),
    ]
    for shift in (-6, 6):
        far, near = (x - 44, y - 22 + shift), (x - 16, y - 4 + shift)
        parts.append(arrow(far, near) if light else arrow((x + 16, y + shift), (x + 46, y + shift)))
    return parts


def net(x: float, y: float, text: str) -> list[str]:
    """Return the end of a wire at a point, with the name of the net that it belongs to."""
    return [dot(x, y, 5, fill="white", stroke=INK), words(x + 10, y + 5, text, font_size=13)]


def amplifier(x: float, y: float) -> list[str]:
    """Return an amplifier whose inverting input is at a point; the other is 38 below."""
    corners = [(x, y - 22), (x, y + 60), (x + 80, y + 19)]
    return [line(corners, True, fill="white"), words(x + 6, y + 6, "-"), words(x + 6, y + 44, "+")]


def channel(x: float, y: float) -> list[str]:
    """Return photodiode, amplifier and the filter before the converter; the input is at (x, y)."""
    band = 1 / (2 * math.pi * IT.feedback_ohm * fitted.FEEDBACK_F)
    node, out = x + 70, x + 200
    return [
        *diode(x, y + 50, True),
        line([(x, y), (x, y + 41)]),
        line([(x, y + 60), (x, y + 92)]),
        *net(x, y + 96, "REF"),
        words(x + 18, y + 66, IT.part),
        line([(x, y), (node + 50, y)]),
        dot(node, y),
        *amplifier(node + 50, y),
        line([(node + 50, y + 39), (node + 20, y + 39), (node + 20, y + 92)]),
        *net(node + 20, y + 96, "REF"),
        words(node + 74, y + 76, "OPA376"),
        line([(node, y), (node, y - 95), (node + 35, y - 95)]),
        *resistor(node + 35, y - 95, f"{IT.feedback_ohm / 1e6:g} MOhm"),
        line([(node + 95, y - 95), (out, y - 95), (out, y + 19)]),
        line([(node, y - 55), (node + 62, y - 55)]),
        *capacitor(node + 65, y - 55, False),
        line([(node + 68, y - 55), (out, y - 55)]),
        words(node + 12, y - 26, f"{fitted.FEEDBACK_F * 1e12:g} pF: {band / 1e3:.0f} kHz",
              font_size=13),
        dot(node, y - 55),
        dot(out, y - 55),
        dot(out, y + 19),
        line([(out, y + 19), (out + 60, y + 19)]),
        words(out + 8, y + 10, "OUT", font_size=13, fill=GREY),
        *resistor(out + 60, y + 19, f"{fitted.FILTER_OHM / 1e3:g} kOhm"),
        line([(out + 120, y + 19), (out + 190, y + 19)]),
        dot(out + 145, y + 19),
        line([(out + 145, y + 19), (out + 145, y + 48)]),
        *capacitor(out + 145, y + 51, True),
        line([(out + 145, y + 54), (out + 145, y + 92)]),
        words(out + 102, y + 56, f"{fitted.FILTER_F * 1e9:g} nF", font_size=13),
        line([(out + 145, y + 82), (out + 190, y + 82)]),
        dot(out + 145, y + 82),
        *net(out + 145, y + 96, "REF"),
        words(out + 152, y + 12, "AINP", font_size=13),
        words(out + 152, y + 75, "AINN", font_size=13),
    ]  # fmt: skip


def reference(x: float, y: float) -> list[str]:
    """Return the divider and the follower that make the reference of all channels."""
    upper, lower = (f"{ohm / 1e3:g} kOhm" for ohm in fitted.DIVIDER_OHM)
    return [
        words(x, y + 5, "3.3 V"),
        line([(x + 44, y), (x + 60, y)]),
        *resistor(x + 60, y, upper),
        line([(x + 120, y), (x + 200, y)]),
        dot(x + 140, y),
        line([(x + 140, y), (x + 140, y + 20)]),
        *box(x + 133, y + 20, 14, 36),
        words(x + 76, y + 44, lower, font_size=13),
        line([(x + 140, y + 56), (x + 140, y + 66)]),
        *ground(x + 140, y + 66),
        dot(x + 175, y),
        line([(x + 175, y), (x + 175, y + 30)]),
        *capacitor(x + 175, y + 33, True),
        line([(x + 175, y + 36), (x + 175, y + 66)]),
        *ground(x + 175, y + 66),
        words(x + 188, y + 56, "10 uF", font_size=13),
        *amplifier(x + 200, y - 39),
        line([(x + 200, y - 39), (x + 186, y - 39), (x + 186, y - 72), (x + 300, y - 72),
              (x + 300, y - 20), (x + 280, y - 20)]),
        dot(x + 300, y - 20),
        *resistor(x + 300, y - 20, f"{fitted.REFERENCE_OHM:g} ohm"),
        line([(x + 360, y - 20), (x + 416, y - 20)]),
        dot(x + 380, y - 20),
        line([(x + 380, y - 20), (x + 380, y + 30)]),
        *capacitor(x + 380, y + 33, True),
        line([(x + 380, y + 36), (x + 380, y + 66)]),
        *ground(x + 380, y + 66),
        words(x + 394, y + 56, f"{fitted.REFERENCE_F * 1e6:g} uF", font_size=13),
        *net(x + 420, y - 20, REFERENCE),
        words(x + 226, y + 36, "OPA376"),
    ]  # fmt: skip


def supply(x: float, y: float) -> list[str]:
    """Return what is made of the vehicle's bus."""
    low, high = fitted.BUS_V
    return [
        *box(x, y, 120, 50, "vehicle bus", f"{low:g} to {high:g} V"),
        arrow((x + 120, y + 25), (x + 150, y + 25)),
        *box(x + 150, y, 120, 50, "TSR 1-2450", f"{fitted.LOGIC_V:g} V"),
        arrow((x + 270, y + 25), (x + 310, y + 25)),
        *box(x + 310, y, 220, 50, "Teensy 4.1, whose 3.3 V has", "MAX3485E and DVDD"),
        line([(x + 290, y + 25), (x + 290, y + 95)]),
        dot(x + 290, y + 25),
        arrow((x + 290, y + 95), (x + 310, y + 95)),
        *box(x + 310, y + 70, 220, 50, f"LP5907: {fitted.ANALOG_V:g} V for amplifiers,",
             "AVDD and the oscillator"),
    ]  # fmt: skip


def lamp(x: float, y: float) -> list[str]:
    """Return battery, current source, LED and optics."""
    low, high = fitted.BUS_V
    return [
        *box(x, y, 120, 60, "vehicle bus", f"{low:g} to {high:g} V"),
        arrow((x + 120, y + 30), (x + 146, y + 30)),
        *box(x + 146, y, 110, 60, "LDD-700H", f"{fitted.DRIVER_A:g} A"),
        line([(x + 256, y + 15), (x + 336, y + 15), (x + 336, y + 21)]),
        words(x + 262, y + 10, "-Vout", font_size=13),
        *diode(x + 336, y + 30, False),
        line([(x + 336, y + 40), (x + 336, y + 45), (x + 256, y + 45)]),
        words(x + 262, y + 60, "+Vout", font_size=13),
        words(x + 240, y + 84, f"L1C1-GRN1, {IT.wavelength_nm:g} nm, {IT.lamp_w:g} W of light",
              font_size=14),
        *box(x + 392, y, 130, 60, "collimator and", "flat window"),
        words(x + 536, y + 35, "beam", fill=GREY),
    ]  # fmt: skip


def schematic() -> str:
    """Return the schematic."""
    bold = {"font_weight": "bold"}
    drawn = [
        words(24, 40, "lamp, on the leader", **bold),
        *lamp(24, 60),
        words(24, 200, "one of 25 detectors: on its disc", **bold),
        words(330, 200, "on the main board", **bold),
        line([(310, 205), (310, 450)], stroke=GREY, stroke_dasharray="5 4"),
        *channel(90, 330),
        *box(440, 222, 190, 50, "oscillator,", f"{fitted.CLOCK_HZ / 1e6:g} MHz, to all CLKIN"),
        arrow((550, 272), (550, 300)),
        *box(480, 300, 140, 130, "4 x ADS131M08", "24 bit, 4 kS/s,", "in step"),
        arrow((550, 430), (550, 480)),
        words(560, 460, "SPI", font_size=13),
        *box(
            460, 480, 170, 100,
            "Teensy 4.1: mean of",
            f"{1e3 * IT.average_s:g} ms, pedestal {IT.pedestal_counts},",
            "array_firmware.c",
        ),
        arrow((460, 530), (420, 530)),
        *box(320, 495, 100, 70, "MAX3485E"),
        arrow((320, 530), (280, 530)),
        *box(180, 495, 100, 70, "computer:", "serial node"),
        words(24, 640, "reference of all channels", **bold),
        *reference(24, 725),
        words(24, 850, "supplies of the array", **bold),
        *supply(24, 870),
    ]  # fmt: skip
    return picture(650, 1010, drawn)
