"""What to order for the instrument of the guide: ``python docs/parts_list.py``.

Prices are estimates. Whether the parts fit each other is in ``docs/parts.py``.
"""

from typing import NamedTuple


class Part(NamedTuple):
    """What to order, how many, about what they cost together, EUR, and from whom."""

    what: str
    order: str
    count: int
    eur: float


PARTS = {
    "lamp": (
        Part("green LED, by its seller on a 20 mm star board", "Lumileds L1C1-GRN1000000000", 1, 8),
        Part("collimator, 25 deg FWHM in air", "by the LED's list of Carclo or LEDiL", 1, 6),
        Part("current source", "Mean Well LDD-700H", 1, 8),
        Part("housing of aluminium, flat acrylic front", "Blue Robotics 2 in series", 1, 120),
    ),
    "each of 25 detectors (and 3 spare)": (
        Part("photodiode, clear (not FA: that one has a filter)", "Vishay BPW34", 28, 28),
        Part("amplifier, SOT-23-5", "TI OPA376AIDBVT", 28, 45),
        Part("1 MOhm, 0.1 %, 25 ppm/K, 0805", "Panasonic ERA-6AEB105V", 28, 20),
        Part("10 pF C0G and 100 nF X7R, 0805", "any", 56, 6),
        Part("disc board, 18 mm, in a panel", "any maker of boards", 28, 30),
    ),
    "main board": (
        Part("converter, TQFP-32", "TI ADS131M08IPBSR", 4, 44),
        Part("1 kOhm, 1 nF C0G and 100 nF, 0805", "any", 90, 8),
        Part("20 and 120 ohm, 220 nF, 1 uF and 10 uF X7R, 0805", "any", 20, 3),
        Part("amplifier of the reference, 64.9 kOhm, 1 kOhm", "TI OPA376AIDBVT", 1, 2),
        Part("oscillator, 8.192 MHz, 3.3 V", "Abracon ASE-8.192MHZ-LC-T", 1, 2),
        Part("regulator, 3.3 V", "TI LP5907MFX-3.3", 1, 1),
        Part("step-down regulator, 5 V", "Traco TSR 1-2450", 1, 6),
        Part("microcontroller", "PJRC Teensy 4.1", 1, 35),
        Part("RS-485 driver", "Maxim MAX3485ECSA+", 1, 4),
        Part("red LED, which blinks at faults", "any", 1, 1),
        Part("board, two layers, 80 x 100 mm", "any maker of boards", 1, 25),
    ),
    "hull and cables": (
        Part("carrier in four quarters of ASA, and its plate", "from the drawing", 1, 150),
        Part("clear epoxy for potting, 0.5 kg", "low-viscosity, for optics", 1, 40),
        Part("housing of the main board", "Blue Robotics 4 in series", 1, 230),
        Part("cable of a row, four pairs, 1 m", "Cat 5e, polyurethane", 5, 15),
        Part("penetrator: five rows, two lines, a spare", "WetLink, M10, 6.5 mm", 8, 90),
        Part("line of array and of lamp, four cores, 20 m", "twisted pairs, polyurethane", 1, 60),
        Part("thermal paste, clear glue, solder, dowels, screws", "any", 1, 30),
        Part("fuse of 1 A, with its holder", "any", 2, 6),
        Part("adapter at the computer", "FTDI USB-RS485-WE-1800-BT", 1, 35),
    ),
    "to test and calibrate": (
        Part("torch, and black cloth", "any", 1, 30),
        Part("straight profile of 6 m with a carriage", "40 x 40 mm aluminium", 1, 90),
        Part("pan and tilt head, inclinometer, steel tape", "0.1 deg, class II", 1, 110),
        Part(
            "pool or tank, 6 m long and 2 m deep, for a day", "hired; a pier costs nothing", 1, 200
        ),
    ),
}


def parts_list() -> str:
    """Return what to order, with sums."""
    lines = [f"{'what':<53}{'order':<38}{'no.':>3} {'EUR':>4}"]
    for group, parts in PARTS.items():
        lines.append(f"\n{group}: {sum(part.eur for part in parts):g} EUR")
        lines += [f"{part.what:<53}{part.order:<38}{part.count:3d} {part.eur:4g}" for part in parts]
    whole = sum(part.eur for parts in PARTS.values() for part in parts)
    return "\n".join([*lines, f"\nall: {whole:g} EUR, estimated"])


if __name__ == "__main__":
    print(parts_list())
