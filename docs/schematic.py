"""The schematic of lamp, one channel and converter, as SVG, for ``docs/generate_reference.py``.

Its values are the defaults of ``uuv_array budget``.
"""

import math

from drawings import GREY, INK, arrow, dot, line, picture, words

from uuv_optical_array.forward.link_budget import Instrument

FEEDBACK_F = 10e-12  # keeps the amplifier stable and its band below the converter's


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


def channel(x: float, y: float) -> list[str]:
    """Return photodiode, amplifier and the filter before the converter; the input is at (x, y)."""
    it = Instrument()
    band = 1 / (2 * math.pi * it.feedback_ohm * FEEDBACK_F)
    node, out = x + 70, x + 230
    return [
        *diode(x, y + 50, True),
        line([(x, y), (x, y + 41)]),
        line([(x, y + 60), (x, y + 90)]),
        *ground(x, y + 90),
        words(x + 18, y + 66, it.part),
        line([(x, y), (node + 50, y)]),
        dot(node, y),
        line([(node + 50, y - 22), (node + 50, y + 60), (out - 30, y + 19)], True, fill="white"),
        words(node + 56, y + 6, "-"),
        words(node + 56, y + 44, "+"),
        line([(node + 50, y + 39), (node + 20, y + 39), (node + 20, y + 66)]),
        *ground(node + 20, y + 66),
        words(node + 44, y + 80, "OPA4376"),
        line([(node, y), (node, y - 95), (node + 45, y - 95)]),
        *resistor(node + 45, y - 95, f"R {it.feedback_ohm / 1e6:g} MOhm"),
        line([(node + 105, y - 95), (out, y - 95), (out, y + 19)]),
        line([(node, y - 55), (node + 72, y - 55)]),
        *capacitor(node + 75, y - 55, False),
        line([(node + 78, y - 55), (out, y - 55)]),
        words(node + 22, y - 29, f"C {FEEDBACK_F * 1e12:g} pF: {band / 1e3:.0f} kHz", font_size=13),
        dot(node, y - 55),
        dot(out, y - 55),
        line([(out - 30, y + 19), (out + 20, y + 19)]),
        dot(out, y + 19),
        *resistor(out + 20, y + 19, "1 kOhm"),
        line([(out + 80, y + 19), (out + 130, y + 19)]),
        dot(out + 95, y + 19),
        line([(out + 95, y + 19), (out + 95, y + 50)]),
        *capacitor(out + 95, y + 53, True),
        line([(out + 95, y + 56), (out + 95, y + 76)]),
        *ground(out + 95, y + 76),
        words(out + 52, y + 58, "1 nF", font_size=13),
    ]


def schematic() -> str:
    """Return the schematic."""
    it = Instrument()
    parts = [
        words(24, 40, "lamp, on the leader", font_weight="bold"),
        *box(24, 60, 120, 60, "battery or", "vehicle bus"),
        arrow((144, 90), (190, 90)),
        *box(190, 60, 160, 60, "current source,", "ripple below 0.1 %"),
        line([(350, 75), (420, 75), (420, 81)]),
        *diode(420, 90, False),
        line([(420, 100), (420, 105), (350, 105)]),
        words(372, 136, f"LED {it.wavelength_nm:g} nm, {it.lamp_w:g} W of light", font_size=14),
        *box(476, 60, 130, 60, "lens and", "flat window"),
        words(630, 95, "beam", fill=GREY),
        words(24, 200, "one of 25 channels, on the follower", font_weight="bold"),
        *channel(90, 330),
        *box(450, 300, 130, 100, "4 x ADS131M08", "24 bit, 4 kS/s,", "in step"),
        arrow((580, 350), (640, 350)),
        *box(
            640,
            300,
            170,
            100,
            "microcontroller:",
            f"mean of {1e3 * it.average_s:g} ms,",
            "array_sender.c",
        ),
        arrow((810, 350), (850, 350)),
        *box(850, 315, 90, 70, "RS-485", "driver"),
        arrow((940, 350), (990, 350)),
        *box(990, 315, 110, 70, "computer:", "serial node"),
        line([(515, 470), (515, 400)], stroke=INK, marker_end="url(#head)"),
        *box(425, 470, 175, 40, "one quartz, 8.192 MHz"),
        line([(600, 490), (725, 490), (725, 400)], marker_end="url(#head)"),
        words(735, 470, "time of the exposure", font_size=13, fill=GREY),
    ]
    return picture(1120, 530, parts)
