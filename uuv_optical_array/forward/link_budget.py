"""From the watts of a lamp to the counts and the noise of a scene, and the safety of its light.

Light and noise are those of the scene: this module only says how many counts a watt gives, which
is one factor for all detectors at all poses.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.effects.electronics import PARTS, Part
from uuv_optical_array.forward.lamp.beam import UNIT, beam_solid_angle, gaussians_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, scene_from_settings

SAFETY_RANGE_M = 0.2  # from the lamp, where IEC 62471 measures
# Largest radiance, W/(m^2 sr), by risk group 0 to 2: for the blue-light hazard, and, times the
# angle that the lamp subtends, for the thermal one (IEC 62471:2006, tables 6.1 and 6.2).
BLUE_LIMITS, THERMAL_LIMITS = (100.0, 1e4, 4e6), (28_000.0, 28_000.0, 71_000.0)
# Weight of the blue-light hazard by the wavelength, nm; beyond 500 nm it is a law (table 4.2).
BLUE_NM = (400, 410, 415, 430, 440, 450, 460, 470, 480, 490, 500)
BLUE = (0.1, 0.4, 0.8, 0.98, 1.0, 0.94, 0.8, 0.62, 0.45, 0.22, 0.1)


@dataclass(frozen=True)
class Instrument:
    """Lamp, detector and converter in the units of data sheets; the scene has beam and water."""

    lamp_w: Annotated[
        float, Quantity("radiant flux of the LED, or of all LEDs together", "W", 1e-6, 1e3)
    ] = 0.33
    optics: Annotated[
        float, Quantity("share of the radiant flux that leaves the lamp", "", 0.01, 1)
    ] = 0.85
    wavelength_nm: Annotated[float, Quantity("wavelength of the lamp", "nm", 400, 700)] = 525.0
    lens_m: Annotated[float, Quantity("diameter of the lamp's lens", "m", 2e-3, 1)] = 0.03
    filter: Annotated[
        float, Quantity("share of the light that window and filter transmit", "", 1e-6, 1)
    ] = 0.8
    part: Annotated[Part, Quantity("type of the photodiode")] = "BPW34"
    feedback_ohm: Annotated[
        float, Quantity("feedback resistor of the amplifier", "ohm", 1, 1e12)
    ] = 1e6
    capacitance_f: Annotated[
        float, Quantity("capacitance at the amplifier's input", "F", 0, 1e-6)
    ] = 80e-12
    amplifier_v_per_rthz: Annotated[
        float, Quantity("voltage noise of the amplifier", "V/sqrt(Hz)", 0, 1)
    ] = 7.5e-9
    amplifier_a_per_rthz: Annotated[
        float, Quantity("current noise of the amplifier", "A/sqrt(Hz)", 0, 1)
    ] = 2e-15
    converter_v_per_rthz: Annotated[
        float, Quantity("voltage noise of the converter", "V/sqrt(Hz)", 0, 1)
    ] = 1.7e-7
    full_scale_v: Annotated[float, Quantity("full scale of the converter", "V", 1e-3, 100)] = 1.2
    bits: Annotated[int, Quantity("resolution of a reading, in bits", "", 4, 16)] = 16
    pedestal_counts: Annotated[
        int,
        Quantity(
            "constant that the sender adds, so that noise in the dark stays above 0", "", 0, 10000
        ),
    ] = 100
    average_s: Annotated[
        float, Quantity("time over which a reading is averaged", "s", 1e-6, 10)
    ] = 0.02
    temperature_c: Annotated[
        float, Quantity("temperature of diode and resistor", "deg C", -40, 100)
    ] = 15.0
    daylight_w_per_m2: Annotated[
        float,
        Quantity("irradiance by daylight on the array, in the filter's band", "W/m^2", 0, 1e3),
    ] = 0.0

    @property
    def amps_per_count(self) -> float:
        """Photocurrent of one count, A."""
        return self.full_scale_v / (2.0**self.bits - 1) / self.feedback_ohm

    @property
    def bandwidth_hz(self) -> float:
        """Noise bandwidth of an average over `average_s`, Hz."""
        return 0.5 / self.average_s

    @property
    def counts_per_w_per_m2(self) -> float:
        """Reading of a detector that faces light of 1 W/m^2, counts."""
        sheet = PARTS[self.part]
        amps = self.filter * sheet.area_m2 * sheet.responsivity_a_per_w
        return amps / self.amps_per_count

    def intensity(self, beam_sigma_deg: float, gaussians: Array = UNIT) -> float:
        """Return the radiant intensity on the axis of a beam of `beam.gaussians_of`, W/sr."""
        solid_angle = beam_solid_angle(math.radians(beam_sigma_deg), gaussians)
        return self.lamp_w * self.optics / solid_angle

    def amplifier_noise(self) -> float:
        """Return the noise of amplifier and converter as a current at the input, A/sqrt(Hz).

        The amplifier's voltage noise e drives a current through the feedback resistor R and, more
        at higher frequencies, through the capacitance C: ``e^2 (1 / R^2 + (2 pi C B)^2 / 3)`` is
        its mean over the bandwidth B (Graeme 1996, Photodiode Amplifiers, chapter 5).
        """
        reactive = (2 * math.pi * self.capacitance_f * self.bandwidth_hz) ** 2 / 3
        voltage = self.amplifier_v_per_rthz**2 * (self.feedback_ohm**-2 + reactive)
        converter = (self.converter_v_per_rthz / self.feedback_ohm) ** 2
        return math.sqrt(voltage + self.amplifier_a_per_rthz**2 + converter)

    def risk_group(
        self, beam_sigma_deg: float, share: float = 1.0, gaussians: Array = UNIT
    ) -> tuple[int, float, float]:
        """Return the risk group of IEC 62471, 0 (exempt) to 3, of a lens that is evenly lit.

        It has a share of the flux. Then come the radiances for blue light and for heat, W/(m^2 sr).
        """
        intensity = share * self.intensity(beam_sigma_deg, gaussians)
        radiance = intensity / (math.pi / 4 * self.lens_m**2)
        wavelength = self.wavelength_nm
        weight = float(np.interp(wavelength, BLUE_NM, BLUE))
        if wavelength > 500:
            weight = max(10 ** ((450 - wavelength) / 50), 1e-3)
        blue, thermal = weight * radiance, max(1.0, 10 * weight) * radiance
        angle = min(self.lens_m / SAFETY_RANGE_M, 0.1)
        hazards = (blue, BLUE_LIMITS), (thermal * angle, THERMAL_LIMITS)
        over = [sum(value > limit for limit in limits) for value, limits in hazards]
        return max(over), blue, thermal


def scene_with(scene: Scene, instrument: Instrument) -> Scene:
    """Return the scene with the `keys` of the instrument; errors as there."""
    settings, changes = scene.settings(), keys(scene, instrument)
    for group, values in changes.items():
        merged = settings[group] | values
        settings[group] = {name: value for name, value in merged.items() if value is not None}
    return scene_from_settings(settings, scene.name)


def keys(scene: Scene, instrument: Instrument) -> dict[str, dict[str, Any]]:
    """Return what a scene file that extends the scene says of the instrument.

    A prior's uncertainty of the ambient keeps its share of full scale. ValueError where the
    reference reading exceeds the bounds of a scene.
    """
    reference = _reference_counts(scene, instrument)
    if not 1 <= reference <= 1e6:
        raise ValueError(
            f"the aligned array would read {reference:.3g} counts at the reference range, but a "
            "scene takes 1 to 1e6; change the feedback resistor or the lamp"
        )
    full_scale = 2.0**instrument.bits - 1
    gone = sorted({"sensor_noise", "shot_noise", "ambient", "pedestal"} & {*scene.effects})
    effects: dict[str, Any] = dict.fromkeys(gone)
    if daylight := instrument.daylight_w_per_m2 * instrument.counts_per_w_per_m2:
        effects["ambient"] = {"level_counts": _short(daylight)}
    effects["photodiode"] = {
        "part": instrument.part,
        "bandwidth_hz": _short(instrument.bandwidth_hz),
        "load_ohm": instrument.feedback_ohm,
        "amplifier_a_per_rthz": _short(instrument.amplifier_noise()),
        "temperature_c": instrument.temperature_c,
        "amps_per_count": _short(instrument.amps_per_count),
    }
    effects["saturation"] = {"level_counts": full_scale}
    if modulated := scene.effects.get("demodulation"):
        level = float(instrument.pedestal_counts)
        effects["demodulation"] = {**modulated, "pedestal_counts": level}
    elif instrument.pedestal_counts:
        effects["pedestal"] = {"level_counts": float(instrument.pedestal_counts)}
    effects["adc"] = {"bits": instrument.bits}
    changes = {"lamp": {"reference_counts": _short(reference)}, "effects": effects}
    if unsure := scene.prior.ambient_std_counts / scene.full_scale_counts:
        changes["prior"] = {"ambient_std_counts": _short(unsure * full_scale)}
    return changes


def least_watts(
    scene: Scene, instrument: Instrument, enough: Callable[[Scene], bool]
) -> float | None:
    """Return the least flux of the LED with which ``enough(scene)`` is true, to 0.1 %; or None.

    `enough` is false for little flux and true from some flux on, as far as no reading saturates.
    """
    per_watt = _reference_counts(scene, instrument) / instrument.lamp_w

    def does(watts: float) -> bool:
        return enough(scene_with(scene, dataclasses.replace(instrument, lamp_w=watts)))

    # A scene's reference reading is from 1 to 1e6 counts.
    watts, most = 1.01 / per_watt, 0.99e6 / per_watt
    for step in (2.0, 1.04, 1.001):  # each from the last flux that was too little
        while not does(min(watts * step, most)):
            watts *= step
            if watts > most:
                return None
    return watts * step


def _reference_counts(scene: Scene, instrument: Instrument) -> float:
    """Return the brightest reading of the aligned array at the reference range, counts."""
    lamp = scene.lamp
    intensity = instrument.intensity(lamp.beam_sigma_deg, gaussians_of(lamp))
    power = intensity * instrument.counts_per_w_per_m2
    return float(lamp.reference_counts * power / ForwardModel(scene).power)


def _short(value: float) -> float:
    return float(f"{value:.6g}")
