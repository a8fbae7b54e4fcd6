"""Photons beside closed forms, quadratures of single scattering, and the law of small angles."""

import itertools

import numpy as np
import pytest
import second_forward
from numpy.polynomial.legendre import leggauss
from scipy.integrate import quad
from trace_photons import ASYMMETRY, INDEX, PHASES, SLOPE, make, quantiles, trace

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies import photon_transport
from uuv_optical_array.studies.photon_transport import (
    EDGES,
    OFF_AXIS,
    RADII_M,
    WATERS,
    Lamp,
    Pencil,
    PhotonSea,
    shipped_pencil,
)

SIGMAS = 5
MIDDLES = (EDGES[1:] + EDGES[:-1]) / 2
SCENE = load_scene("reference")
MODEL, POSE = ForwardModel(SCENE), np.array([-5.0, 0.4, -0.3, 0.1, -0.2])
RAYS = second_forward.rays(SCENE.settings()["array"], POSE)
SPHERES = [2, 6, 10, 16]  # of 2, 4, 6 and 9 m


def fournier_forand(angle):
    """Return the phase function, 1/sr, as Fournier and Jonasz 1999 print it."""

    def delta_at(half):
        return 4 / (3 * (INDEX - 1) ** 2) * half

    nu, half = (3 - SLOPE) / 2, np.sin(angle / 2) ** 2
    delta, back = delta_at(half), delta_at(1.0)
    power = delta**nu
    forward = nu * (1 - delta) - (1 - power) + (delta * (1 - power) - nu * (1 - delta)) / half
    rear = (1 - back**nu) / (16 * np.pi * (back - 1) * back**nu) * (3 * np.cos(angle) ** 2 - 1)
    return forward / (4 * np.pi * (1 - delta) ** 2 * power) + rear


def henyey_greenstein(angle):
    g = ASYMMETRY
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * np.cos(angle)) ** 1.5)


DENSITIES = {"fournier_forand": fournier_forand, "henyey_greenstein": henyey_greenstein}


def share(density, low, high, weight=lambda angle: 1.0):
    """Integrate a phase function over a ring of directions, in the logarithm of the angle."""

    def at(log_angle):
        angle = np.exp(log_angle)
        return 2 * np.pi * density(angle) * weight(angle) * np.sin(angle) * angle

    return quad(at, np.log(low), np.log(high), limit=400, epsabs=1e-9)[0]


@pytest.mark.parametrize("phase", PHASES)
def test_scattering_angles_have_the_distribution_of_the_phase_function(phase):
    density, half = DENSITIES[phase], quantiles(phase)
    least = 1e-9
    assert share(density, least, np.pi) == pytest.approx(1, abs=2e-4)
    for low, high in ((1e-3, 0.01), (0.01, 0.1), (0.1, 0.5), (0.5, 1.5), (np.pi / 2, np.pi)):
        ends = np.sin(np.array([low, high]) / 2) ** 2
        found = np.interp(ends, half, np.linspace(0, 1, len(half)))
        assert np.diff(found) == pytest.approx(share(density, low, high), rel=2e-3, abs=2e-5)
    mean = share(density, least, np.pi, np.cos)
    assert 1 - (half[1:] + half[:-1]).mean() == pytest.approx(mean, abs=3e-4)


def test_phase_functions_are_those_of_the_sea():
    backscatter = 1 - PHASES["fournier_forand"](np.array(0.5))
    assert backscatter == pytest.approx(0.0183, abs=1e-4)  # Mobley, Sundman and Boss 2002
    assert share(henyey_greenstein, 1e-9, np.pi, np.cos) == pytest.approx(ASYMMETRY, abs=1e-6)


def test_water_that_does_not_scatter_leaves_a_gaussian_beam():
    nothing = np.zeros((len(RADII_M), len(MIDDLES)))
    lamp = Lamp(Pencil(0.3, 0.2, "henyey_greenstein", 1, nothing, nothing, nothing), 0.15)
    light = [second_forward.ideal(ray, np.degrees(0.15)) * np.exp(-0.5 * ray[0]) for ray in RAYS]
    assert lamp.images(MODEL, POSE[None]).ravel() == pytest.approx(light, rel=1e-9)


def test_a_detector_reads_the_flux_through_its_face():
    lamp = Lamp(shipped_pencil("harbour"), 0.15)
    r, eta, _, *place = np.array([ray[:6] for ray in RAYS]).T
    normals, turn = np.array([ray.looks for ray in RAYS]).T, np.arctan2(place[2], place[1])
    off = np.array([np.sin(eta), np.cos(eta) * np.cos(turn), np.cos(eta) * np.sin(turn)])
    radial, away = lamp.vector(r, eta)
    light = np.maximum(-((radial * place / r + away * off) * normals).sum(axis=0), 0)
    assert (away > 0.01 * radial).all()
    assert lamp.images(MODEL, POSE[None]).ravel() == pytest.approx(light, rel=1e-9)


@pytest.mark.parametrize("phase", [*PHASES, "isotropic"])
def test_without_absorption_all_energy_crosses_every_sphere(phase, monkeypatch):
    monkeypatch.setitem(PHASES, "isotropic", lambda half: half)
    pencil = trace(0.0, 0.8, phase, 10_000, np.random.default_rng(1))
    total = np.exp(-0.8 * RADII_M) + pencil.radial.sum(axis=1)
    # As if the crossings of a photon, outwards and back, were independent of one another.
    error = np.sqrt(pencil.squares.sum(axis=1) / pencil.photons)
    assert error.max() < 0.055
    assert (np.abs(total - 1) < SIGMAS * error).all()


def test_light_scattered_once_agrees_with_a_quadrature():
    """Compare the flux on and off the axis, at such thin water that nothing is scattered twice.

    In the triangle of lamp, place of scattering and detector, with angles g at the lamp and h at
    the detector, the inverse squares and the volume leave ``dg dh dturn / range``.
    """
    a, b = 0.4, 1e-4
    pencil = trace(a, b, "henyey_greenstein", 400_000, np.random.default_rng(2))
    lamps = [Lamp(pencil, sigma) for sigma in np.radians([4.0, 8.0])]
    x, wx = leggauss(240)
    root, wx = (x + 1) / 2, wx / 2
    theta, w_theta = np.pi * root**3, 3 * np.pi * root**2 * wx  # dense at small angles
    y, wy = leggauss(30)
    turns = (np.arange(24) + 0.5) * np.pi / 24
    t, f, turn = np.meshgrid(theta, (y + 1) / 2, turns, indexing="ij")
    g, h = t * f, t * (1 - f)
    weight = (w_theta * theta)[:, None, None] * (wy / 2)[:, None] * (2 * np.pi / 24)
    for lamp, i, j in itertools.product(lamps, SPHERES, (0, 16, 30)):
        r, eta = RADII_M[i], OFF_AXIS[j]
        path = r * (np.sin(g) + np.sin(h)) / np.sin(t)
        cosine = np.cos(eta) * np.cos(g) + np.sin(eta) * np.sin(g) * np.cos(turn)
        beam = np.exp(-(np.arccos(np.clip(cosine, -1, 1)) ** 2) / (2 * lamp.sigma**2))
        light = weight * beam * b * np.exp(-(a + b) * path) * henyey_greenstein(t) * r
        outwards, away = (light * np.cos(h)).sum(), (light * np.sin(h) * np.cos(turn)).sum()
        error = lamp.error[i, j]
        assert error < 0.01 * outwards
        assert abs(lamp.flux[0, i, j] - outwards) < SIGMAS * error
        assert lamp.flux[1, i, j] == pytest.approx(away, rel=0.03, abs=1e-12)


def test_small_angles_spread_as_fermi_and_eyges_say(monkeypatch):
    square = np.radians(1.0) ** 2  # mean of a scattering, of which most are below 1.5 deg
    monkeypatch.setitem(PHASES, "narrow", lambda half: -np.expm1(-4 * half / square))
    b, photons = 1.5, 40_000
    pencil = trace(0.0, b, "narrow", photons, np.random.default_rng(3))
    spread = (pencil.radial * MIDDLES**2).sum(axis=1)
    turned = (pencil.away * MIDDLES).sum(axis=1)
    # A Gaussian in two dimensions; few scatterings vary more.
    rel = SIGMAS * 2 / np.sqrt(photons)
    assert spread == pytest.approx(b * square * RADII_M / 3, rel=rel)
    assert turned[SPHERES] == pytest.approx(b * square * RADII_M[SPHERES] / 6, rel=2 * rel)


def test_absorption_dims_light_that_is_scattered_little_by_beer(monkeypatch):
    monkeypatch.setitem(PHASES, "narrow", lambda half: -np.expm1(-half / 1e-6))
    pencil = trace(0.7, 0.5, "narrow", 20_000, np.random.default_rng(4))
    total = np.exp(-0.5 * RADII_M) * np.exp(-0.7 * RADII_M) + pencil.radial.sum(axis=1)
    assert total == pytest.approx(np.exp(-0.7 * RADII_M), rel=0.04)


def test_a_pencil_is_read_as_it_was_written(tmp_path, monkeypatch, capsys):
    make(tmp_path, 1000)
    made = sorted(tmp_path.glob("*"))
    assert {path.stem for path in made} == {f"{w}_{phase}" for w in WATERS for phase in PHASES}
    assert sorted(capsys.readouterr().out.split()) == list(map(str, made))
    monkeypatch.setattr(photon_transport.files, "shared_file", lambda name: tmp_path / name[12:])
    again = shipped_pencil("coastal")
    pencil = trace(*WATERS["coastal"], "fournier_forand", 1000, np.random.default_rng(1))
    assert (again.phase, again.photons) == ("fournier_forand", 1000)
    for name in ("absorption_per_m", "scattering_per_m", "radial", "away", "squares"):
        assert getattr(again, name) == pytest.approx(getattr(pencil, name), rel=1e-6)


@pytest.mark.parametrize("water", WATERS)
def test_shipped_photons_are_of_petzolds_waters_and_agree_with_a_few_new_ones(water):
    pencil = shipped_pencil(water)
    a, b = pencil.absorption_per_m, pencil.scattering_per_m
    assert (a, b) == WATERS[water]
    shipped = Lamp(pencil, 0.2)
    fresh = Lamp(trace(a, b, "fournier_forand", 4000, np.random.default_rng(8)), 0.2)
    axis = shipped.vector(RADII_M, np.zeros(len(RADII_M)))[0] * RADII_M**2
    assert (shipped.error[:, 0] < 2e-3 * axis).all()
    error = np.hypot(fresh.error, shipped.error)[:, :60]
    assert (np.abs(fresh.flux[0] - shipped.flux[0])[:, :60] < SIGMAS * error).all()


def test_a_scene_keeps_its_reference_reading_and_its_gains_in_the_water_of_photons():
    scene, pencil = load_scene("coastal"), shipped_pencil("coastal")
    sea = PhotonSea(scene, pencil)
    poses = np.array([[-scene.lamp.reference_range_m, 0, 0, 0, 0], [-6.0, 0.4, -0.3, 0.1, -0.2]])
    light = sea.light(poses)
    assert light[0].max() == pytest.approx(scene.lamp.reference_counts)
    spread = scene.effects["responsivity"]["spread"]
    bare = Lamp(pencil, np.radians(scene.lamp.beam_sigma_deg)).images(sea.model, poses)
    gains = light / bare
    assert gains[1] == pytest.approx(gains[0])
    assert np.std(gains[0] / gains[0].mean()) == pytest.approx(spread, rel=0.5)


def test_chance_is_as_large_as_stated(monkeypatch):
    # Enough turns for so smooth a beam.
    monkeypatch.setattr(photon_transport, "TURNS", (np.arange(16) + 0.5) * np.pi / 16)
    seeds = [np.random.default_rng((6, i)) for i in range(24)]
    lamps = [Lamp(trace(0.2, 0.5, "fournier_forand", 2000, rng), 0.2) for rng in seeds]
    found = np.std([lamp.flux[0][:, :60] for lamp in lamps], axis=0, ddof=1)
    stated = np.mean([lamp.error[:, :60] for lamp in lamps], axis=0)
    assert np.median(found / stated) == pytest.approx(1, abs=0.2)


def test_places_beyond_the_spheres_are_refused():
    lamp = Lamp(shipped_pencil("clear"), 0.1)
    with pytest.raises(ValueError, match=r"photons are known from 1 to 10 m and up to 60 deg"):
        lamp.images(MODEL, np.array([[-12.0, 0, 0, 0, 0]]))
