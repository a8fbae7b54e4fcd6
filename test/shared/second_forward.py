"""The forward model written a second time, number by number, from the formulas as published.

It shares with the package the names of a scene's settings, the data sheets of the photodiodes and
the seeds of what is drawn, and no law. A scene is the mapping that `Scene.settings` returns.
"""

import copy
import functools
import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation
from scipy.special import expit

from uuv_optical_array.forward.effects.electronics import PARTS

CHARGE, BOLTZMANN = 1.602176634e-19, 1.380649e-23  # C, J/K: exact by definition of the SI


class Ray(NamedTuple):
    """From the lamp to a detector: m, rad, and where the detector is in ``beacon``."""

    range_m: float
    off_axis: float
    cosine: float
    x: float
    y: float
    z: float
    looks: list
    time_s: float | None


def attitude(pitch, yaw, roll):
    """Rotation from ``base_link`` to ``beacon``: yaw about z, pitch about y, roll about x."""
    return Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()


def detectors(array):
    """Places and normals in ``base_link``: rows from the top, columns from port (eqs 9 to 12)."""
    side, width = array["detectors_per_side"], array["width_m"]
    for row in range(side):
        for column in range(side):
            y = width / 2 - column * width / (side - 1)
            z = width / 2 - row * width / (side - 1)
            if array["shape"] == "planar":
                yield [array["bow_m"], y, z], [1.0, 0.0, 0.0]
            else:
                radius = array["radius_m"]
                x = math.sqrt(radius**2 - y**2 - z**2)
                yield [array["bow_m"] + x, y, z], [x / radius, y / radius, z / radius]


def rays(array, pose, roll=0.0, time_s=None):
    """Return the ray to each detector; the lamp at the origin of ``beacon`` shines along -x."""
    turn = attitude(pose[3], pose[4], roll)
    places, normals = np.array([*detectors(array)]).swapaxes(0, 1)
    found = []
    for (x, y, z), looks in zip(
        (pose[:3] + places @ turn.T).tolist(), (normals @ turn.T).tolist(), strict=True
    ):
        range_m = math.sqrt(x * x + y * y + z * z)
        cosine = -(x * looks[0] + y * looks[1] + z * looks[2]) / range_m
        off_axis = math.atan2(math.hypot(y, z), -x)
        found.append(Ray(range_m, off_axis, cosine, x, y, z, looks, time_s))
    return found


def gaussian(angle, sigma):
    return math.exp(-(angle**2) / (2 * sigma**2))


def ideal(ray, sigma_deg):
    """Light of a lamp of unit power: inverse square, Gaussian beam, Lambert (eqs 1 to 4, 8)."""
    beam = gaussian(ray.off_axis, math.radians(sigma_deg))
    return beam * max(0.0, ray.cosine) / ray.range_m**2


def through_sea(ray, sigma_deg, absorption_per_m, scattering_per_m):
    """Net flux of a lamp of unit power in ``beacon``: core and halo, each from its own point."""
    sigma, depth = math.radians(sigma_deg), scattering_per_m * ray.range_m
    scattered = 1 - math.exp(-0.188 * depth)
    core = math.sqrt(sigma**2 + 0.0013 * depth / 3)
    halo = math.sqrt(core**2 + 0.0754 * 0.188 * depth / (3 * scattered))
    lost = math.exp(-(absorption_per_m + 0.0562 * scattering_per_m) * ray.range_m)
    flux = np.zeros(3)
    for weight, width, factor in ((1 - scattered, core, 2), (scattered, halo, 1)):
        tilt = factor * (1 - (sigma / width) ** 2)
        # From there the angle off the axis is larger by the tilt, in small angles.
        source = -tilt / (1 + tilt) * ray.range_m
        way = np.array([ray.x - source, ray.y, ray.z])
        strength = weight * (sigma / width) ** 2 * gaussian(ray.off_axis, width)
        flux += strength * way / np.linalg.norm(way)
    return flux * lost / ray.range_m**2


# On the way: the factor of the light of a ray.


def attenuation(ray, lamp, k_per_m):
    return math.exp(-k_per_m * ray.range_m)


def lamp_flicker(ray, lamp, depth, frequency_hz):
    if ray.time_s is None:
        return 1.0
    return 1 + depth * math.sin(2 * math.pi * math.fmod(ray.time_s * frequency_hz, 1.0))


@functools.cache
def waves(seed):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(16).tolist(), rng.uniform(0, 2 * math.pi, 16).tolist()


def lamp_drift(ray, lamp, std, time_scale_s, seed):
    if ray.time_s is None:
        return 1.0
    rates, phases = waves(seed)
    total = 0.0
    for rate, phase in zip(rates, phases, strict=True):
        total += math.cos(rate / time_scale_s * ray.time_s + phase)
    return math.exp(std * math.sqrt(2 / 16) * total)


@functools.cache
def clouds(seed, extent_m, size_m):
    rng = np.random.default_rng(seed)
    return rng.uniform(0, extent_m, 12).tolist(), rng.normal(0, size_m, 12).tolist()


def plume(ray, lamp, depth, size_m, speed_m_per_s, distance_m, seed, extent_m):
    if ray.time_s is None or -ray.x < distance_m:
        return 1.0
    # Where the ray pierces the plane of the clouds.
    y, z = ray.y * distance_m / -ray.x, ray.z * distance_m / -ray.x
    thickness = 0.0
    for place, height in zip(*clouds(seed, extent_m, size_m), strict=True):
        gap = math.remainder(y - place - speed_m_per_s * ray.time_s, extent_m)
        thickness += math.exp(-(gap**2 + (z - height) ** 2) / (2 * size_m**2))
    return math.exp(-depth * thickness)


def field_of_view(ray, lamp, cosine_power=None, half_angle_deg=None, edge_deg=None):
    if ray.cosine <= 0:
        return 1.0  # of no light
    if cosine_power is not None:
        return ray.cosine**cosine_power / ray.cosine
    half, edge = math.radians(half_angle_deg), math.radians(edge_deg)
    within = (ray.cosine - math.cos(half)) / (math.sin(half) * edge / 2)
    return float(expit(2 * within))


def window(ray, lamp, index, behind_index, water_index):
    """Fresnel's coefficients by angles: sines and tangents of sums and differences."""
    passed, angle = 1.0, math.acos(min(max(ray.cosine, 1e-6), 1.0))
    for before, after in ((water_index, index), (index, behind_index)):
        sine = before / after * math.sin(angle)
        if sine >= 1:
            return 0.0
        refracted = math.asin(sine)
        if angle + refracted < 1e-4:
            reflected = ((before - after) / (before + after)) ** 2
        else:
            less, more = angle - refracted, angle + refracted
            reflected = (math.sin(less) / math.sin(more)) ** 2 / 2
            reflected += (math.tan(less) / math.tan(more)) ** 2 / 2
        passed, angle = passed * (1 - reflected), refracted
    return passed


# On the array: the image, rows of columns, is changed in place.


def ambient(image, array, level_counts):
    image += level_counts


def forward_scatter(image, array, window_m):
    spacing = array["width_m"] / (array["detectors_per_side"] - 1)
    most = math.ceil(window_m / spacing)
    way = np.arange(-most, most + 1) * spacing
    weights = np.where(abs(way) < window_m / 2, 1 + np.cos(2 * math.pi * way / window_m), 0.0)
    for axis in (0, 1):  # light beyond an edge is as that before it
        image[:] = ndimage.correlate1d(image, weights / weights.sum(), axis, mode="reflect")


def responsivity(image, array, drift_per_c, spread=None, seed=None, gains=None, temperature_c=0.0):
    if gains is None:
        draws = np.random.default_rng(seed).standard_normal(image.shape)
        gains = np.maximum(1 + spread * draws, 0.0)
    image *= np.multiply(gains, 1 + drift_per_c * temperature_c)


def detector_faults(image, array, dead, stuck, stuck_counts):
    for row, column in dead:
        image[row, column] = 0.0
    for row, column in stuck:
        image[row, column] = stuck_counts


# In the electronics: the variance of a reading by its light, and what becomes of a reading.


def sensor_noise(light, sigma_counts, relative=0.0):
    return sigma_counts**2


def trembling(lit, effects):
    """Return the variance of what is relative to a reading, whatever way it was detected."""
    return (effects.get("sensor_noise", {}).get("relative", 0.0) * lit) ** 2


def shot_noise(light, electrons_per_count):
    # A count of electrons is Poisson.
    return light * electrons_per_count / electrons_per_count**2


def photodiode(
    light,
    part,
    bandwidth_hz,
    load_ohm,
    amplifier_a_per_rthz,
    temperature_c,
    amps_per_count=None,
    watts_per_m2_per_count=None,
):
    sheet = PARTS[part]
    if amps_per_count is None:
        amps_per_count = watts_per_m2_per_count * sheet.area_m2 * sheet.responsivity_a_per_w
    parallel = load_ohm * sheet.shunt_resistance_ohm / (load_ohm + sheet.shunt_resistance_ohm)
    current = light * amps_per_count + sheet.dark_current_a
    shot = 2 * CHARGE * current * bandwidth_hz
    johnson = 4 * BOLTZMANN * (temperature_c + 273.15) * bandwidth_hz / parallel
    return (shot + johnson + amplifier_a_per_rthz**2 * bandwidth_hz) / amps_per_count**2


def saturation(reading, level_counts):
    return min(reading, level_counts)


def demodulated(scene, light):
    """Variance of a reading by sums over 1,000 samples of a period, beside a plain mean's."""
    ways = {
        "square": (lambda t: 2.0 * (t < 0.5), lambda t: math.pi / 2 * math.sin(2 * math.pi * t)),
        "sine": (lambda t: 1 + math.sin(2 * math.pi * t), lambda t: 2 * math.sin(2 * math.pi * t)),
        "slots": (lambda t: 2.0 * (t < 0.5), lambda t: 1.0 if t < 0.5 else -1.0),
    }
    settings, effects = scene["effects"]["demodulation"], scene["effects"]
    lamp, reference = ways[settings["waveform"]]
    times = [(i + 0.5) / 1000 for i in range(1000)]
    lit = max(light - settings["pedestal_counts"], 0.0)
    daylight = effects.get("ambient", {}).get("level_counts", 0.0)
    total = 0.0
    for t in times:
        signal = daylight + lit * lamp(t)
        noise = sum(law(signal, **effects[name]) for name, law in NOISE.items() if name in effects)
        total += reference(t) ** 2 * noise / 1000
    return total + trembling(lit, effects)


def pedestal(reading, level_counts):
    return reading + level_counts


def black(effects):
    """Return the reading of darkness."""
    level = effects.get("demodulation", {}).get("pedestal_counts", 0.0)
    return pedestal(level, **effects.get("pedestal", {"level_counts": 0.0}))


def adc(reading, bits):
    return float(min(max(math.floor(reading + 0.5), 0), 2**bits - 1))


def named(*functions):
    return {function.__name__: function for function in functions}


# Within each stage in physical order.
WAY = named(attenuation, lamp_flicker, lamp_drift, plume, field_of_view, window)
ARRAY = named(ambient, forward_scatter, responsivity, detector_faults)
NOISE = named(sensor_noise, shot_noise, photodiode)
LIMITS = named(saturation, adc)
ELECTRONICS = {
    **NOISE,
    "saturation": saturation,
    "demodulation": demodulated,
    "pedestal": pedestal,
    "adc": adc,
}
EFFECTS = {"attenuation": attenuation, "sea": through_sea, **WAY, **ARRAY, **ELECTRONICS}
RESPONSE = "field_of_view.cosine_power"  # whose offset acts in any scene
LOGARITHMS = "sea.scattering_per_m"  # settings whose offset is that of their logarithm


def with_offsets(effects, offsets):
    """Return the settings of effects with offsets added, by dotted name."""
    changed = copy.deepcopy(effects)
    for name, offset in offsets.items():
        effect, setting = name.split(".")
        if effect in effects and not setting.startswith("to_") and name != RESPONSE:
            before = changed[effect].get(setting, 0.0)
            after = before * math.exp(offset) if name in LOGARITHMS else before + offset
            changed[effect][setting] = after
    return changed


@functools.cache
def shapes(side):
    """Return the places of the detectors, from -1 to 1, and the modes of shades by number."""
    places = [-1 + 2 * i / (side - 1) for i in range(side)]
    grid = np.array([(u, v) for v in places for u in places])
    order = np.array([[1, u, v, u * u, u * v, v * v] for u, v in grid])
    modes = {}
    for k in range(1, 6):
        # What the lower orders leave of this one, by regression.
        before = order[:, :k]
        rest = order[:, k] - before @ np.linalg.lstsq(before, order[:, k], rcond=None)[0]
        size = math.sqrt(np.mean(rest**2))
        if size > 1e-9:
            modes[k] = rest / size
    return grid, modes


def unnamed(side, effects, offsets):
    """Return what has no effect: a factor of the lamp's light and daylight, by detector."""
    grid, modes = shapes(side)
    shades, daylight = np.zeros(side**2), np.zeros(side**2)
    for k, mode in modes.items():
        shades = shades + offsets.get(f"shade.mode_{k}", 0.0) * mode
    for name, axis in (("to_starboard", 0), ("to_bottom", 1)):
        daylight = daylight + offsets.get(f"ambient.{name}_counts", 0.0) * grid[:, axis]
    if "ambient" not in effects:
        daylight = daylight + offsets.get("ambient.level_counts", 0.0)
    return np.exp(shades), daylight + offsets.get("lamp.floor_counts", 0.0)


def image_of(scene, power, effects, pose, roll=0.0, time_s=None, offsets=None):
    """Return the light of a lamp of some power, shape ``(side, side)``."""
    offsets, array = offsets or {}, dict(scene["array"])
    if "array.radius_m" in offsets and array["shape"] == "curved":
        array["radius_m"] *= math.exp(offsets["array.radius_m"])
    lamp = dict(scene["lamp"])
    lamp["beam_sigma_deg"] += offsets.get("lamp.beam_sigma_deg", 0.0)
    readings = []
    from_light = [pose[0] - lamp.get("behind_m", 0.0), *pose[1:]]
    for ray in rays(array, from_light, roll, time_s):
        if "sea" in effects:
            flux = through_sea(ray, lamp["beam_sigma_deg"], **effects["sea"])
            size = np.linalg.norm(flux)
            ray = ray._replace(cosine=float(-flux @ ray.looks / size) if size > 0 else 0.0)
            light = power * float(size) * max(0.0, ray.cosine)
        else:
            light = power * ideal(ray, lamp["beam_sigma_deg"])
        for name, law in WAY.items():
            if name in effects and light > 0:
                light *= law(ray, lamp, **effects[name])
        if light > 0:
            light *= ray.cosine ** offsets.get(RESPONSE, 0.0)
        if "attenuation" not in effects:
            light *= attenuation(ray, lamp, offsets.get("attenuation.k_per_m", 0.0))
        readings.append(light)
    side = array["detectors_per_side"]
    shades, daylight = unnamed(side, effects, offsets)
    daylight = daylight + lamp.get("floor_counts", 0.0)
    image = (np.array(readings) * shades + daylight).reshape(side, side)
    for name, step in ARRAY.items():
        if name in effects and not (name == "ambient" and "demodulation" in effects):
            step(image, array, **effects[name])
    return image + black(effects)


def power_of(scene):
    """Return the power of the lamp, counts m^2: its own share of the reference reading."""
    lamp = scene["lamp"]
    aligned = (-lamp["reference_range_m"], 0, 0, 0, 0)
    # Of a lamp so strong that beside it daylight and stuck detectors are nothing.
    strong = image_of(scene, 1e100, scene["effects"], aligned)
    return lamp["reference_counts"] / (strong.max() / 1e100)


def light(scene, pose, roll=0.0, offsets=None, time_s=None, power=None):
    """Return the light on the detectors, counts, shape ``(side, side)``."""
    offsets = offsets or {}
    power = power_of(scene) if power is None else power
    power *= math.exp(offsets.get("lamp.power", 0.0))
    effects = with_offsets(scene["effects"], offsets)
    return image_of(scene, power, effects, pose, roll, time_s, offsets)


def noise_variance(scene, light):
    """Return the variance of an analogue reading about its light, counts^2."""
    effects = scene["effects"]
    if "demodulation" in effects:
        return demodulated(scene, light)
    lit = max(light - black(effects), 0.0)
    noise = sum(law(lit, **effects[name]) for name, law in NOISE.items() if name in effects)
    return noise + trembling(lit, effects)


def variance(scene, light):
    """Return that of a reading: rounding is uniform within a count; a thousandth is the least."""
    rounding = 1 / 12 if "adc" in scene["effects"] else 0.0
    return max(noise_variance(scene, light) + rounding, 1e-6)


def converted(scene, reading):
    """Return what the electronics make of an analogue reading."""
    effects = scene["effects"]
    for name, law in LIMITS.items():
        if name in effects:
            settings = effects[name]
            if name == "saturation" and "demodulation" in effects:
                room = settings["level_counts"] - effects.get("ambient", {}).get("level_counts", 0)
                level = effects["demodulation"]["pedestal_counts"] + room / 2
                settings = {"level_counts": level}
            reading = law(reading, **settings)
    return reading
