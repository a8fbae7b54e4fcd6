"""From lamp to readings of one scene, with derivatives, for NumPy at many poses and compiled.

Components come first: a position is ``(3, ...)``, an image with its derivatives
``(1 + p, ..., n)``. With NumPy, each component holds any number of poses, shape ``(m, 1)``; in
compiled code it is a number, of one pose.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from numpy import sqrt

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.elementwise import (
    beside,
    exp,
    indices,
    law,
    maximum,
    sandwich,
    workspace,
    zeros,
)
from uuv_optical_array.forward.effects.detectors import housing, lens, port
from uuv_optical_array.forward.effects.water import beer
from uuv_optical_array.forward.lamp.lamps import (
    DEGREE,
    GEOMETRY,
    PLACE_X,
    SHARE,
    SIGMA,
    one_of_lamps,
)
from uuv_optical_array.forward.light import (
    ALONG,
    AXIAL,
    COSINE,
    HALF_SQUARE,
    INCIDENCE,
    INVERSE,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    RANGE,
    RAY_ROWS,
    TO_X,
    TO_Y,
    TO_Z,
    TURN,
    added,
    gaussian,
    lambert,
    lamp_light,
    off_axis,
    ray,
    slopes_by_lamp,
)
from uuv_optical_array.forward.scattering import joined, scattered_light, weighed

# Rows of the beam: light, slopes of its logarithm and of the incidence; then by laws' settings.
LIGHT, BY_RANGE, BY_HALF_SQUARE, BY_INCIDENCE, BY_SIGMA, BY_SCATTERING = range(6)
IN_RANGE, IN_HALF_SQUARE, IN_COSINE, IN_AXIAL, IN_SIGMA = range(6, 11)
BEAM_ROWS = 11
# Laws of transmission, each with a branch in `transmit`.
LAWS = beer, lens, housing, port
BEER, LENS, HOUSING, PORT = range(4)
# Kinds of step on the array.
BACKGROUND, GAIN, BLUR, SHADE = range(4)
LEAST_DEPTH = 1e-6  # squared, of a detector on the sphere's rim, as a share of the radius


class Optics(NamedTuple):
    """A scene in numbers.

    - detectors: their positions, m, and normals, shape ``(6, n)``.
    - radius_m: of the sphere that carries the detectors, m; 0: there is none.
    - power: of all lamps, as in `light.lamp_light`.
    - lamps, lamp_at: as `lamps` and `places` of `lamps.one_of_lamps`.
    - gaussians: of the beams, as `beam.gaussians_of` returns them.
    - scattering_per_m: of the water, 1/m; 0: it does not scatter.
    - nuisances: number of settings that have offsets.
    - power_at, sigma_at, scattering_at, radius_at: index among the nuisances of the offsets of
      these, in logarithms but for the beam's sigma, deg; -1: known.
    - laws, law_settings, law_at: of transmission: places in `LAWS`; their settings, shape ``(laws,
      3)``; index of the nuisance that is the first of these, as `power_at`.
    - step_kinds, step_values, step_scales, step_at: of each step on the array: `BACKGROUND`,
      `GAIN`, `BLUR` or `SHADE`; pattern, gains or logarithms, shape ``(steps, n)``; level of a
      background or slope of gains; index of the nuisance, as `power_at`.
    - blur: of one axis, shape ``(side, side)``.
    """

    detectors: Array
    radius_m: float
    power: float
    lamps: Array
    lamp_at: Any
    gaussians: Array
    scattering_per_m: float
    nuisances: int
    power_at: int
    sigma_at: int
    scattering_at: int
    radius_at: int
    laws: Any
    law_settings: Array
    law_at: Any
    step_kinds: Any
    step_values: Array
    step_scales: Array
    step_at: Any
    blur: Array


def trace(optics: Optics, lamp: Any, nuisances: Any, rays: Any) -> None:
    """Write the `light.ray` from the lamp (six components) to each detector, ``(14, ..., n)``."""
    lamp_x, lamp_y, lamp_z, axis_x, axis_y, axis_z = lamp
    axis = axis_x, axis_y, axis_z
    detectors, radius_m = optics.detectors, optics.radius_m
    flatter, scale = optics.radius_at >= 0, 1.0
    if flatter:
        scale = exp(nuisances[optics.radius_at])
    # Of more rows in one loop the compiler makes no vectors.
    for j in indices(detectors.shape[1]):
        x, y, z = detectors[0, j], detectors[1, j], detectors[2, j]
        normal_x, normal_y, normal_z = detectors[3, j], detectors[4, j], detectors[5, j]
        if flatter:
            # The detectors keep their places across the array, so a larger sphere is flatter.
            depth = sqrt(maximum(scale * scale - 1 + normal_x * normal_x, LEAST_DEPTH))
            x = x + radius_m * (depth - normal_x)
            normal_x, normal_y, normal_z = depth / scale, normal_y / scale, normal_z / scale
        rays[TO_X, j], rays[TO_Y, j], rays[TO_Z, j] = lamp_x - x, lamp_y - y, lamp_z - z
        rays[NORMAL_X, j], rays[NORMAL_Y, j], rays[NORMAL_Z, j] = normal_x, normal_y, normal_z
    for j in indices(detectors.shape[1]):
        to = rays[TO_X, j], rays[TO_Y, j], rays[TO_Z, j]
        normal = rays[NORMAL_X, j], rays[NORMAL_Y, j], rays[NORMAL_Z, j]
        range_m, inverse, half_sine_squared, cosine, axial, along_m = ray(to, normal, axis)
        half_square, turn = off_axis(along_m, half_sine_squared, inverse)
        rays[RANGE, j], rays[INVERSE, j], rays[HALF_SQUARE, j] = range_m, inverse, half_square
        rays[COSINE, j], rays[INCIDENCE, j], rays[AXIAL, j] = cosine, cosine, axial
        rays[ALONG, j], rays[TURN, j] = along_m, turn


def shine(rays: Any, power: Any, beam_sigma_rad: Any, gaussians: Any, beam: Any) -> None:
    """Write the light in water that does not scatter, and its slopes, into the rows of `beam`."""
    n, weights, widths = rays.shape[-1], gaussians[0], gaussians[1]
    for j in indices(n):
        first = gaussian(rays[HALF_SQUARE, j], beam_sigma_rad, weights[0], widths[0])
        beam[LIGHT, j], beam[BY_HALF_SQUARE, j] = first
    # Of a loop over the Gaussians within one over the readings the compiler makes no vectors: three
    # would take 12 times as long as one, not 1.7 times.
    for k in range(1, len(weights)):
        weight, width = weights[k], widths[k]
        for j in indices(n):
            part, slope = gaussian(rays[HALF_SQUARE, j], beam_sigma_rad, weight, width)
            whole = added(beam[LIGHT, j], beam[BY_HALF_SQUARE, j], part, slope)
            beam[LIGHT, j], beam[BY_HALF_SQUARE, j] = whole
    for j in indices(n):
        to_lamp = rays[INVERSE, j], rays[HALF_SQUARE, j], rays[INCIDENCE, j]
        radiant = beam[LIGHT, j], beam[BY_HALF_SQUARE, j]
        light, by_range, by_incidence, by_sigma = lamp_light(
            *to_lamp, power, beam_sigma_rad, *radiant
        )
        beam[LIGHT, j], beam[BY_RANGE, j], beam[BY_INCIDENCE, j] = light, by_range, by_incidence
        beam[BY_SIGMA, j], beam[BY_SCATTERING, j] = by_sigma, 0.0
        beam[IN_RANGE, j], beam[IN_HALF_SQUARE, j], beam[IN_COSINE, j] = 0.0, 0.0, 1.0
        beam[IN_AXIAL, j], beam[IN_SIGMA, j] = 0.0, 0.0


def scatter(
    rays: Any, power: Any, beam_sigma_rad: Any, gaussians: Any, scattering_per_m: Any, beam: Any
) -> None:
    """Write the light in water that scatters, as `shine` does, with its incidence."""
    n, weights, widths = rays.shape[-1], gaussians[0], gaussians[1]
    for j in indices(n):
        angle, depth = angle_at(rays, j), scattering_per_m * rays[RANGE, j]
        write_source(weighed(angle, beam_sigma_rad, depth, weights[0], widths[0]), j, beam)
    for k in range(1, len(weights)):
        weight, width = weights[k], widths[k]
        for j in indices(n):
            angle, depth = angle_at(rays, j), scattering_per_m * rays[RANGE, j]
            further = weighed(angle, beam_sigma_rad, depth, weight, width)
            write_source(joined(source_at(beam, j), further), j, beam)
    for j in indices(n):
        light, incidence = scattered_light(
            rays[RANGE, j],
            rays[INVERSE, j],
            angle_at(rays, j),
            rays[COSINE, j],
            rays[AXIAL, j],
            power,
            beam_sigma_rad,
            scattering_per_m,
            source_at(beam, j),
        )
        beam[LIGHT, j], beam[BY_RANGE, j], beam[BY_HALF_SQUARE, j] = light[0], light[1], light[2]
        beam[BY_SIGMA, j], beam[BY_SCATTERING, j] = light[3], light[4]
        rays[INCIDENCE, j], beam[IN_RANGE, j] = incidence[0], incidence[1]
        beam[IN_HALF_SQUARE, j], beam[IN_COSINE, j] = incidence[2], incidence[3]
        beam[IN_AXIAL, j], beam[IN_SIGMA, j] = incidence[4], incidence[5]
    for j in indices(n):
        facing, beam[BY_INCIDENCE, j] = lambert(rays[INCIDENCE, j])
        beam[LIGHT, j] *= facing


@law
def write_source(source: Any, j: Any, beam: Any) -> None:
    """Keep where the light of reading j seems to come from, as of `scattering.core_and_halo`."""
    beam[LIGHT, j], beam[BY_SCATTERING, j] = source[0], source[1]
    beam[BY_HALF_SQUARE, j], beam[BY_SIGMA, j] = source[2], source[3]
    beam[IN_COSINE, j], beam[IN_RANGE, j] = source[4], source[5]
    beam[IN_HALF_SQUARE, j], beam[IN_SIGMA, j] = source[6], source[7]


@law
def source_at(beam: Any, j: Any) -> tuple[Any, Any, Any, Any, Any, Any, Any, Any]:
    """Return what `write_source` keeps."""
    light = beam[LIGHT, j], beam[BY_SCATTERING, j], beam[BY_HALF_SQUARE, j], beam[BY_SIGMA, j]
    return *light, beam[IN_COSINE, j], beam[IN_RANGE, j], beam[IN_HALF_SQUARE, j], beam[IN_SIGMA, j]


@law
def angle_at(rays: Any, j: Any) -> tuple[Any, Any, Any]:
    """Return the angle off the axis of reading j, as of `scattered_light`."""
    inverse = rays[INVERSE, j]
    return rays[HALF_SQUARE, j], rays[ALONG, j] * inverse, inverse / rays[TURN, j]


def write_light(
    optics: Optics, lamp: Any, slopes: Any, attitude: Any, nuisances: Any, image: Any
) -> None:
    """Write the light on the array, of one lamp below the other, and its slopes, as `project`.

    Lamp and slopes are those of one at the origin of ``beacon``; the attitude is pitch, yaw and
    roll of the follower, rad. The image has L times the detectors.
    """
    count, n, rows = optics.lamps.shape[1], optics.detectors.shape[1], len(image)
    rays = workspace(RAY_ROWS, lamp[0], n)
    beam = workspace(BEAM_ROWS + len(optics.laws), lamp[0], n)
    by_geometry, several = zeros(6, GEOMETRY, lamp[0]), count > 1
    moved = several or optics.lamps[PLACE_X, 0] != 0
    own_slopes = zeros(6, slopes.shape[1] if moved else 0, lamp[0])
    own = workspace(rows if several else 0, lamp[0], n)
    for i in range(count):
        one, one_slopes, one_image = lamp, slopes, image
        if moved:
            known = optics.lamps, optics.lamp_at, i, attitude, nuisances
            one = one_of_lamps(*known, lamp, slopes, own_slopes, by_geometry)
            one_slopes = own_slopes
        if several:
            one_image = own
        illuminate(optics, i, one, nuisances, rays, beam, rows > 1)
        project(optics, i, one, one_slopes, by_geometry, nuisances, rays, beam, one_image)
        if several:
            beside(own, i, image)


def transmitter(law: Callable[..., Any]) -> Callable[..., None]:
    """Return what changes the light by a law of transmission with settings a, b and c."""

    def transmit(
        rays: Any, a: Any, b: Any, c: Any, beam: Any, row: Any, differentiate: bool
    ) -> None:
        for j in indices(rays.shape[-1]):
            factor, by_range, by_incidence, by_a = law(rays[RANGE, j], rays[INCIDENCE, j], a, b, c)
            beam[LIGHT, j] *= factor
            if differentiate:
                beam[BY_RANGE, j] += by_range
                beam[BY_INCIDENCE, j] += by_incidence
                beam[row, j] = by_a

    # A linker takes functions of one name, in files of the cache, for the same one.
    transmit.__qualname__ = f"transmit_{law.__name__}"
    return transmit


transmit_beer, transmit_lens, transmit_housing, transmit_port = map(transmitter, LAWS)


def transmit(
    law: int, rays: Any, a: Any, b: Any, c: Any, beam: Any, row: Any, differentiate: bool
) -> None:
    """Change the light by the law of a place in `LAWS`, as `transmitter` has it."""
    if law == BEER:
        transmit_beer(rays, a, b, c, beam, row, differentiate)
    elif law == LENS:
        transmit_lens(rays, a, b, c, beam, row, differentiate)
    elif law == HOUSING:
        transmit_housing(rays, a, b, c, beam, row, differentiate)
    elif law == PORT:
        transmit_port(rays, a, b, c, beam, row, differentiate)


def illuminate(
    optics: Optics, i: int, lamp: Any, nuisances: Any, rays: Any, beam: Any, differentiate: bool
) -> None:
    """Write the rays from lamp i to each detector and the light that arrives there.

    Lamp and axis are six components, nuisances ``(q, ...)``. Results are rows of `light.ray`,
    ``(14, ..., n)``, and of the beam with those of laws, ``(11 + laws, ..., n)``.
    """
    power, beam_sigma_rad = optics.power * optics.lamps[SHARE, i], optics.lamps[SIGMA, i]
    scattering_per_m = optics.scattering_per_m
    if optics.power_at >= 0:
        power = power * exp(nuisances[optics.power_at])
    if optics.sigma_at >= 0:
        beam_sigma_rad = beam_sigma_rad + DEGREE * nuisances[optics.sigma_at]
    if optics.scattering_at >= 0:
        scattering_per_m = scattering_per_m * exp(nuisances[optics.scattering_at])
    trace(optics, lamp, nuisances, rays)
    if optics.scattering_per_m > 0:
        scatter(rays, power, beam_sigma_rad, optics.gaussians, scattering_per_m, beam)
    else:
        shine(rays, power, beam_sigma_rad, optics.gaussians, beam)
    for i in range(len(optics.laws)):
        first = optics.law_settings[i, 0]
        if optics.law_at[i] >= 0:
            first = first + nuisances[optics.law_at[i]]
        second, third = optics.law_settings[i, 1], optics.law_settings[i, 2]
        given = rays, first, second, third, beam, BEAM_ROWS + i, differentiate
        transmit(optics.laws[i], *given)


def project(
    optics: Optics,
    i: int,
    lamp: Any,
    lamp_slopes: Any,
    by_geometry: Any,
    nuisances: Any,
    rays: Any,
    beam: Any,
    image: Any,
) -> None:
    """Write the light of lamp i on the array, and its slopes by p coordinates and q nuisances.

    `lamp_slopes` are those of lamp and axis by the coordinates, shape ``(6, p, ...)``, and
    `by_geometry` those by what ``optics.lamp_at`` has. The image has shape ``(1 + p + q, ..., n)``,
    or of light alone ``(1, ..., n)``.
    """
    size, n = lamp_slopes.shape[1], rays.shape[-1]
    for j in indices(n):
        image[0, j] = beam[LIGHT, j]
    if len(image) == 1:
        return
    vectors = workspace(6, lamp[0], n)
    _, _, _, axis_x, axis_y, axis_z = lamp
    for j in indices(n):
        light, by_incidence = beam[LIGHT, j], beam[BY_INCIDENCE, j]
        lean = light * by_incidence
        by_ray = (
            light * (beam[BY_RANGE, j] + by_incidence * beam[IN_RANGE, j]),
            light * (beam[BY_HALF_SQUARE, j] + by_incidence * beam[IN_HALF_SQUARE, j]),
            lean * beam[IN_COSINE, j],
        )
        radial, facing, bend = slopes_by_lamp(
            by_ray, rays[INVERSE, j], rays[COSINE, j], rays[ALONG, j], rays[TURN, j]
        )
        by_axial = lean * beam[IN_AXIAL, j]
        to_x, to_y, to_z = rays[TO_X, j], rays[TO_Y, j], rays[TO_Z, j]
        normal_x, normal_y, normal_z = rays[NORMAL_X, j], rays[NORMAL_Y, j], rays[NORMAL_Z, j]
        vectors[0, j] = radial * to_x + facing * normal_x + bend * axis_x
        vectors[1, j] = radial * to_y + facing * normal_y + bend * axis_y
        vectors[2, j] = radial * to_z + facing * normal_z + bend * axis_z
        vectors[3, j] = bend * to_x + by_axial * normal_x
        vectors[4, j] = bend * to_y + by_axial * normal_y
        vectors[5, j] = bend * to_z + by_axial * normal_z
    for q in range(size):
        by_x, by_y, by_z = lamp_slopes[0, q], lamp_slopes[1, q], lamp_slopes[2, q]
        by_u, by_v, by_w = lamp_slopes[3, q], lamp_slopes[4, q], lamp_slopes[5, q]
        for j in indices(n):
            image[1 + q, j] = (
                vectors[0, j] * by_x
                + vectors[1, j] * by_y
                + vectors[2, j] * by_z
                + vectors[3, j] * by_u
                + vectors[4, j] * by_v
                + vectors[5, j] * by_w
            )
    first = 1 + size
    for row in range(first, len(image)):
        for j in indices(n):
            image[row, j] = 0.0
    if optics.power_at >= 0:
        for j in indices(n):
            image[first + optics.power_at, j] = image[0, j]
    if optics.sigma_at >= 0:
        for j in indices(n):
            slope = beam[BY_SIGMA, j] + beam[BY_INCIDENCE, j] * beam[IN_SIGMA, j]
            image[first + optics.sigma_at, j] = image[0, j] * slope * DEGREE
    if optics.scattering_at >= 0:
        for j in indices(n):
            slope = beam[BY_INCIDENCE, j] * beam[IN_RANGE, j] * rays[RANGE, j]
            image[first + optics.scattering_at, j] = image[0, j] * (beam[BY_SCATTERING, j] + slope)
    if optics.radius_at >= 0:
        radius_m = optics.radius_m * exp(nuisances[optics.radius_at])
        for j in indices(n):
            lean, over = image[0, j] * beam[BY_INCIDENCE, j], rays[INVERSE, j]
            straight, axial = lean * beam[IN_COSINE, j] * over, lean * beam[IN_AXIAL, j]
            # The sphere's front moves ahead, and all normals lean towards it.
            ahead = 1 / rays[NORMAL_X, j]
            turn_x, turn_y = straight * rays[TO_X, j], straight * rays[TO_Y, j]
            turn_z = straight * rays[TO_Z, j]
            turn_x, turn_y = turn_x + axial * axis_x, turn_y + axial * axis_y
            turn_z = turn_z + axial * axis_z
            turned = turn_x * (ahead - rays[NORMAL_X, j])
            turned = turned - turn_y * rays[NORMAL_Y, j] - turn_z * rays[NORMAL_Z, j]
            image[first + optics.radius_at, j] = turned - vectors[0, j] * radius_m * ahead
    for k in range(len(optics.law_at)):
        if optics.law_at[k] >= 0:
            for j in indices(n):
                image[first + optics.law_at[k], j] = image[0, j] * beam[BEAM_ROWS + k, j]
    for q in range(GEOMETRY):
        if optics.lamp_at[q, i] >= 0:
            for j in indices(n):
                slope = vectors[0, j] * by_geometry[0, q]
                for k in range(1, 6):
                    slope = slope + vectors[k, j] * by_geometry[k, q]
                image[first + optics.lamp_at[q, i], j] = slope


def detect(optics: Optics, nuisances: Any, image: Any) -> None:
    """Apply the steps on the array to an image of `project`, with or without slopes, in place."""
    rows, n = len(image), image.shape[-1]
    first, differentiate = rows - optics.nuisances, rows > 1
    passed = workspace(1, image[0], n)
    for i in range(len(optics.step_kinds)):
        kind, values, scale = optics.step_kinds[i], optics.step_values[i], optics.step_scales[i]
        place = optics.step_at[i]
        if kind == BACKGROUND:
            if place >= 0:
                scale = scale + nuisances[place]
                if differentiate:
                    for j in indices(n):
                        image[first + place, j] += values[j]
            for j in indices(n):
                image[0, j] += scale * values[j]
        elif kind == GAIN:
            if place >= 0:
                common = 1 + scale * nuisances[place]
                for row in range(1, rows):
                    for j in indices(n):
                        image[row, j] *= common
                if differentiate:
                    for j in indices(n):
                        image[first + place, j] += scale * image[0, j]
                for j in indices(n):
                    image[0, j] *= common
            for row in range(rows):
                for j in indices(n):
                    image[row, j] *= values[j]
        elif kind == SHADE:
            depth = nuisances[place]
            for j in indices(n):
                passed[0, j] = exp(depth * values[j])
            for row in range(rows):
                for j in indices(n):
                    image[row, j] *= passed[0, j]
            if differentiate:
                for j in indices(n):
                    image[first + place, j] += values[j] * image[0, j]
        else:
            sandwich(optics.blur, image)
