"""The light of seas that differ from the scene: closed forms, and the second forward model."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
import second_forward as second
from scenes import changed as changed_scene
from scipy import stats
from scipy.spatial.transform import Rotation

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings
from uuv_optical_array.forward.working_volume import DAY_S, uniform_poses
from uuv_optical_array.studies.mismatches import kinds
from uuv_optical_array.studies.mismatches.kinds import KINDS, SHIPPED, kinds_named

POSES = uniform_poses(4, np.random.default_rng(3))
BY_NAME = {kind.name: kind for kind in KINDS}


def settings_of(name="reference", array=None, **effects):
    return changed_scene(name, array=array or {}, effects=effects).settings()


# Daylight tells apart what belongs to the lamp and what does not.
SEA = {"ambient": {"level_counts": 20.0}, "forward_scatter": {"window_m": 0.3}}
SUNLIT = settings_of(**SEA)
CLEAR = settings_of(attenuation=None)


def model_of(settings):
    return ForwardModel(scene_from_settings(settings, "sea"))


def light_of(name, settings=SUNLIT, poses=POSES, seed=5):
    return BY_NAME[name].light(model_of(settings), poses, np.random.default_rng(seed))


def by_second(settings, poses=POSES, power_of=SUNLIT, **words):
    """Return the light of a truth by the second model, the lamp's power that of the scene."""
    power = second.power_of(power_of) * words.pop("factor", 1.0)
    return np.stack([second.light(settings, pose, power=power, **words) for pose in poses])


def changed(group, key, by):
    settings = settings_of(**SEA)
    inner = settings["effects"][group] if group in settings["effects"] else settings[group]
    inner[key] += by
    return settings


def without(effect, settings=SUNLIT):
    effects = {name: values for name, values in settings["effects"].items() if name != effect}
    return {**settings, "effects": effects}


def resized(**sizes):
    return settings_of(array=sizes, **SEA)


def turned_to_starboard(deg):
    """Return the poses turned about the lamp, by SciPy."""
    turn = Rotation.from_euler("z", -deg, degrees=True)
    return np.column_stack([turn.apply(POSES[:, :3]), POSES[:, 3], POSES[:, 4] - np.radians(deg)])


ASIDE, ABOVE = np.array([0, 0.3, 0, 0, 0]), np.array([0, 0, 1.0, 0, 0])
LAMP = without("ambient")
TRUTHS = {
    "nothing": lambda: by_second(SUNLIT),
    "k-0.05": lambda: by_second(changed("attenuation", "k_per_m", -0.05)),
    "k+0.02": lambda: by_second(changed("attenuation", "k_per_m", 0.02)),
    "beam-2": lambda: by_second(changed("lamp", "beam_sigma_deg", -2)),
    "beam+0.6": lambda: by_second(changed("lamp", "beam_sigma_deg", 0.6)),
    "power_x0.5": lambda: by_second(SUNLIT, factor=0.5),
    "power_x2": lambda: by_second(SUNLIT, factor=2.0),
    "ambient_10": lambda: by_second(changed("ambient", "level_counts", 10)),
    "second_lamp_0.3": lambda: by_second(SUNLIT) + 0.3 * by_second(LAMP, POSES - ASIDE),
    "response-5": lambda: by_second(
        SUNLIT, offsets={"field_of_view.cosine_power": math.log(0.95) / math.log(math.sqrt(0.75))}
    ),
    "radius_x0.95": lambda: by_second(resized(radius_m=0.95 * 0.32)),
    "width_x1.05": lambda: by_second(resized(width_m=1.05 * 0.4)),
    "lamp_axis_2": lambda: by_second(SUNLIT, turned_to_starboard(2)),
    "reflection": lambda: by_second(SUNLIT) + 0.1 * by_second(LAMP, POSES - ABOVE),
    "rolled_15": lambda: by_second(SUNLIT, roll=math.radians(15)),
    "gradient_30": lambda: by_second(SUNLIT) + np.linspace(0, 30, 5),  # from port to starboard
    # Starboard and port change places, of the image and of the world.
    "mirrored": lambda: by_second(SUNLIT, POSES * [1, -1, 1, 1, -1]),
}


def test_every_kind_is_off_by_what_it_says():
    times = {kind.name: kind.times_prior for kind in KINDS}
    assert len(times) == len(KINDS)
    within = {kind.name for kind in KINDS if kind.within}
    assert {"nothing", "k-0.04", "beam+0.6", "power_x0.8", "ambient_10", "gains_0.01"} < within
    assert not within & {"k-0.05", "beam-2", "power_x2", "gains_0.02", "gradient_30", "blob"}
    assert times["power_x0.5"] == pytest.approx(0.5 / SHIPPED["lamp_power_std"])
    assert times["mirrored"] is times["gradient_10"] is None
    for kind in KINDS:
        assert re.fullmatch(r"[\w+.-]+", kind.name)  # no comma, which parts names
        for sentence in (kind.what, kind.cure):
            assert re.fullmatch(r"[A-Z].*\.", sentence)


@pytest.mark.parametrize("name", TRUTHS)
def test_light_is_that_of_the_second_model(name):
    np.testing.assert_allclose(light_of(name), TRUTHS[name](), rtol=1e-9, atol=1e-9)


def test_twice_the_scattering_is_that_of_such_a_sea():
    one, twice = (
        settings_of(attenuation=None, sea={"absorption_per_m": 0.1, "scattering_per_m": scattering})
        for scattering in (0.2, 0.4)
    )
    found = light_of("scattering_x2", one)
    np.testing.assert_allclose(found, by_second(twice, power_of=one), rtol=1e-9)
    with pytest.raises(ValueError, match="scattering_x2 needs the effect sea"):
        kinds_named("scattering_x2", load_scene("reference"))


@pytest.mark.parametrize(
    ("name", "number", "gain", "counts"),
    [
        *(("two_dirty", 2, 0.8, 0), ("glint", 1, 1, 50), ("snow", 3, 0.7, 0)),
        *(("dead_detector", 1, 0, 0), ("stuck_detector", 1, 0, 1023)),
    ],
)
def test_faults_are_of_so_many_detectors_any_of_them_as_often(name, number, gain, counts):
    poses = np.repeat(POSES, 500, axis=0)
    plain, found = light_of("nothing", poses=poses), np.minimum(light_of(name, poses=poses), 1023)
    differs = found != plain
    assert (differs.sum(axis=(1, 2)) == number).all()
    np.testing.assert_allclose(found[differs], gain * plain[differs] + counts)
    assert stats.chisquare(differs.sum(axis=0).ravel()).pvalue > 1e-3


@pytest.mark.parametrize("name", ["two_dirty", "glint", "dead_detector", "stuck_detector"])
def test_a_faulty_detector_is_faulty_in_the_image_of_each_lamp(name):
    scene = load_scene("leading_lights")
    model = ForwardModel(scene)
    poses = np.repeat([[-5.0, 0.1, 0.1, 0.0, 0.0]], 20, axis=0)
    plain, found = (
        BY_NAME[kind].light(model, poses, np.random.default_rng(5)) for kind in ("nothing", name)
    )
    side = scene.array.detectors_per_side
    differs = (found != plain).reshape(len(poses), scene.lamp_count, side, side)
    assert differs.any(axis=(1, 2, 3)).all()
    assert (differs == differs[:, :1]).all()


def test_water_can_attenuate_more_in_a_scene_without_attenuation_and_not_less():
    murky = {**CLEAR, "effects": {"attenuation": {"k_per_m": 0.05}, **CLEAR["effects"]}}
    np.testing.assert_allclose(light_of("k+0.05", CLEAR), by_second(murky, power_of=CLEAR))
    scene = scene_from_settings(CLEAR, "clear")
    assert {"k+0.02", "beam-2"} < {kind.name for kind in kinds_named(None, scene)}
    with pytest.raises(ValueError, match=r"k-0\.02 needs .* 0\.02 /m, which scene clear has not"):
        kinds_named("k-0.02", scene)


def test_what_moves_is_that_of_the_moments_that_are_drawn():
    settings = settings_of("night_plume")
    moments = np.random.default_rng(5).uniform(0, DAY_S, 4)
    expected = [
        by_second(settings, [pose], settings, time_s=moment)[0]
        for pose, moment in zip(POSES, moments, strict=True)
    ]
    np.testing.assert_allclose(light_of("moving", settings), expected, rtol=1e-6)
    with pytest.raises(ValueError, match=r"moving needs .*plume, which scene reference has not"):
        kinds_named("moving", load_scene("reference"))


def test_an_array_that_is_turned_on_its_mount_stays_where_it_is():
    direction, turned = np.random.default_rng(5).uniform(0, 2 * np.pi, 4), []
    for pose, turn in zip(POSES, direction, strict=True):
        pitch, yaw = pose[3:] + np.radians(1) * np.array([np.sin(turn), np.cos(turn)])
        swing = second.attitude(*pose[3:], 0) - second.attitude(pitch, yaw, 0)
        place = pose[:3] + swing @ [SUNLIT["array"]["bow_m"], 0, 0]
        turned.append([*place, pitch, yaw])
    np.testing.assert_allclose(light_of("aim_1"), by_second(SUNLIT, turned), rtol=1e-9)


# What is drawn for each frame.
MANY = np.repeat(POSES[:1], 2000, axis=0)


def test_gains_are_independent_and_as_wide_as_they_are_called():
    gains = light_of("gains_0.02", poses=MANY) / light_of("nothing", poses=MANY)
    assert stats.kstest((gains.ravel() - 1) / 0.02, "norm").pvalue > 1e-3
    flat = gains.reshape(len(gains), -1)
    between = np.corrcoef(flat.T) - np.eye(flat.shape[1])
    assert np.abs(between).max() < 6 / math.sqrt(len(gains))


def test_a_shade_is_smooth_and_as_deep_as_it_is_called():
    dark = 20.0  # daylight is not shaded
    lit = light_of("nothing", poses=MANY) - dark
    depth = np.log((light_of("shade_0.1", poses=MANY) - dark) / lit)
    side = depth.shape[-1]
    assert np.sqrt(np.mean(depth**2)) == pytest.approx(0.1, rel=0.05)
    column, row = np.meshgrid(np.arange(side), np.arange(side))
    terms = [column**i * row**j for i in range(3) for j in range(3 - i)]
    plane = np.stack(terms).reshape(6, -1).T.astype(float)
    rest = np.linalg.lstsq(plane, depth.reshape(len(depth), -1).T, rcond=None)[1]
    assert rest.max() < 1e-18
    assert np.linalg.matrix_rank(depth.reshape(len(depth), -1), tol=1e-6) == 5


@pytest.mark.parametrize(("name", "gain"), [("dark_rows", 0.0), ("dim_rows", 0.9)])
def test_two_neighbouring_rows_of_each_frame_lose_light(name, gain):
    ratio = light_of(name, poses=MANY) / light_of("nothing", poses=MANY)
    np.testing.assert_allclose(ratio, ratio[..., :1] + np.zeros(ratio.shape[-1]))
    rows = [tuple(np.flatnonzero(frame < 0.95)) for frame in ratio[..., 0]]
    assert set(rows) == {(i, i + 1) for i in range(ratio.shape[1] - 1)}
    np.testing.assert_allclose(np.sort(ratio[..., 0], axis=1)[:, :2], gain)
    np.testing.assert_allclose(np.sort(ratio[..., 0], axis=1)[:, 2:], 1)


def test_a_hard_shadow_covers_half_of_the_array_from_any_side():
    shaded = light_of("half_shadow", poses=MANY)
    lit = light_of("nothing", poses=MANY)
    dark = np.isclose(shaded, 20.0)  # daylight stays
    assert (dark | np.isclose(shaded, lit)).all()
    side = dark.shape[-1]
    assert not dark[:, side // 2, side // 2].any()
    # What is opposite to a dark detector is lit, so that nearly half are dark.
    assert (dark ^ dark[:, ::-1, ::-1]).sum() == dark.size - len(dark)
    assert 0.4 < dark[:, 0, 0].mean() < 0.6


def off_axis(settings):
    """Return how far to port and off the lamp's axis detectors are, in sigmas of the beam."""
    places, sigma = model_of(settings).array.positions, settings["lamp"]["beam_sigma_deg"]
    seen = np.stack([pose[:3] + places @ second.attitude(*pose[3:], 0).T for pose in POSES])
    port = np.arctan2(seen[..., 1], -seen[..., 0])
    off = np.arccos(-seen[..., 0] / np.linalg.norm(seen, axis=-1))
    return [np.degrees(angle).reshape(len(POSES), 5, 5) / sigma for angle in (port, off)]


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        # Half of its peak where the Gaussian has it: at 1.1774 sigma.
        (
            "moffat",
            lambda _, off: (1 + 0.259921 * (off / 1.177410) ** 2) ** -3 / np.exp(-(off**2) / 2),
        ),
        ("ring_0.03", lambda _, off: 1 + 0.03 * np.exp(-((off - 1) ** 2) / 0.18)),
        ("cut_off", lambda port, _: stats.norm.sf(port, 1, 0.2)),
        ("hidden_row_0.5", lambda *_: np.where(np.arange(5)[:, None] == 4, 0.5, 1.0)),
    ],
)
def test_a_lamp_of_another_shape_or_half_hidden(name, factor):
    lit = light_of("nothing") - 20.0  # daylight stays
    np.testing.assert_allclose(light_of(name) - 20.0, lit * factor(*off_axis(SUNLIT)), rtol=1e-5)


def test_a_bent_converter_is_right_at_zero_half_and_full_scale():
    settings = settings_of(ambient={"level_counts": 0.0})
    kind, model = BY_NAME["bent_0.01"], model_of(settings)
    for light, off in ((0.0, 0.0), (1023 / 4, 10.23), (1023 / 2, 0.0), (3 * 1023 / 4, -10.23)):
        lit = SimpleNamespace(model=model, light=lambda light=light: np.full((1, 5, 5), light))
        np.testing.assert_allclose(kind.of_sea(lit) - light, off, atol=1e-9)


def test_dirt_and_bubbles_take_their_share_anywhere():
    lit = light_of("nothing", poses=MANY) - 20.0
    column, row = (axis / 2 - 1 for axis in np.meshgrid(np.arange(5.0), np.arange(5.0)))
    for name, terms in (
        ("fouled_0.3", [column**0, column, row]),
        ("bubble_0.3", [column**0, column, row, column**2 + row**2]),
    ):
        lost = 1 - (light_of(name, poses=MANY) - 20.0) / lit
        assert 0.29 < lost.max() < 0.3 + 1e-9
        # In the logarithm a plane, or a round parabola.
        for each in lost[:100]:
            there = each > 1e-6
            if there.sum() > len(terms):
                by = np.stack(terms)[:, there].T
                fitted = by @ np.linalg.lstsq(by, np.log(each[there]), rcond=None)[0]
                np.testing.assert_allclose(fitted, np.log(each[there]), atol=1e-6)
        middle = lost.mean(axis=0)
        np.testing.assert_allclose(middle, middle[::-1, ::-1], atol=0.01)


def test_noise_is_uniform_and_blobs_are_gaussian():
    readings = light_of("noise", poses=MANY[:50]).ravel()
    assert stats.kstest(readings / 1023, "uniform").pvalue > 1e-3
    blobs = light_of("blob", poses=MANY[:50])
    side = blobs.shape[-1]
    column, row = np.meshgrid(np.arange(side), np.arange(side))
    terms = np.stack([column**0, column, row, column**2, row**2]).reshape(5, -1).T.astype(float)
    rest = np.linalg.lstsq(terms, np.log(blobs).reshape(50, -1).T, rcond=None)[1]
    assert rest.max() < 1e-12
    assert blobs.max() <= 1023


def test_poses_nearer_and_farther_aside_than_the_table():
    poses, near, aside = (
        draw(100, np.random.default_rng(1))
        for draw in (uniform_poses, kinds.near_poses, kinds.aside_poses)
    )
    np.testing.assert_allclose(near[:, 0], -2)
    np.testing.assert_allclose(near[:, 1:3] / 2, -poses[:, 1:3] / poses[:, :1])
    np.testing.assert_allclose(np.hypot(aside[:, 1], aside[:, 2]), 1.5)
    np.testing.assert_allclose(aside[:, 1] * poses[:, 2], aside[:, 2] * poses[:, 1])
    for other in (near, aside):
        np.testing.assert_array_equal(other[:, 3:], poses[:, 3:])


@pytest.mark.parametrize("name", ["radius_x0.95", "width_x1.05"])
@pytest.mark.parametrize(("radius_m", "holds"), [(0.32, True), (0.29, False)])
def test_a_sphere_that_is_hardly_wide_enough_can_be_no_smaller(name, radius_m, holds):
    scene = scene_from_settings(resized(radius_m=radius_m), "tight")
    assert (name in {kind.name for kind in kinds_named(None, scene)}) == holds


def test_a_narrow_beam_does_not_light_what_is_far_aside():
    narrow = changed_scene("reference", lamp={"beam_sigma_deg": 3.0})
    names = {kind.name for kind in kinds_named(None, narrow)}
    assert "near_2m" in names
    assert "aside_1.5m" not in names
    with pytest.raises(ValueError, match=r"aside_1\.5m needs light .* scene changed has not"):
        kinds_named("aside_1.5m", narrow)


# Modulated lamps: detection sample by sample, and what is known of it in closed form.
MODULATED = settings_of("leading_lights")
SLOTS = settings_of("leading_lights", demodulation={"waveform": "slots"})


def of_lamps(light):
    return light.reshape(len(light), 3, 5, 5)


def lamps_of(settings, poses=POSES):
    """Return the light of each lamp without the pedestal."""
    return of_lamps(model_of(settings).light(poses)) - 20.0


def test_what_modulated_lamps_miss_is_said():
    one, plain = load_scene("sunlit_modulated"), load_scene("follow")
    flat = plain.settings()
    flat["lamp"].update(beam_widths=[1.0, 2.0], beam_weights=[0.7, 0.3])
    there = {kind.name for kind in kinds_named(None, one)}
    assert {"waves_40", "same_carrier_0.3"} < there
    assert not {"second_lamp_0.3", "late_slots_0.01", "hidden_lamp"} & there
    for name, scene, missing in (
        ("waves_40", plain, "the effect demodulation"),
        ("late_slots_0.01", one, "the effect demodulation with slots"),
        ("hidden_lamp", one, "several lamps"),
        ("ambient_10", one, "readings without demodulation"),
        ("moffat", model_of(flat).scene, "a beam of one Gaussian"),
    ):
        with pytest.raises(ValueError, match=f"{name} needs {missing}, which"):
            kinds_named(name, scene)


@pytest.mark.parametrize(("name", "share"), [("one_lamp_x0.7", 0.7), ("hidden_lamp", 0.0)])
def test_one_lamp_of_each_frame_is_dim(name, share):
    shares = (of_lamps(light_of(name, MODULATED, MANY)) - 20.0) / lamps_of(MODULATED, MANY)
    np.testing.assert_allclose(shares, shares[..., :1, :1] + np.zeros((5, 5)), atol=1e-9)
    np.testing.assert_allclose(np.sort(shares[..., 0, 0], axis=1), [[share, 1, 1]] * len(MANY))
    assert (shares[..., 0, 0] < 0.9).any(axis=0).all()


def test_late_slots_shine_into_the_next():
    first, second_, third = np.moveaxis(lamps_of(SLOTS), 1, 0)
    late = np.stack([0.99 * first, 0.99 * second_ + 0.01 * first, 0.99 * third + 0.01 * second_])
    found = of_lamps(light_of("late_slots_0.01", SLOTS)) - 20.0
    np.testing.assert_allclose(found, np.moveaxis(late - 0.01 * third, 0, 1), atol=1e-9)


def test_the_lamp_of_another_leader_is_read_by_the_phase_of_its_carrier():
    beside = lamps_of(MODULATED, POSES[:1] - ASIDE).sum(axis=1)
    clear = light_of("nothing", MODULATED, MANY)
    added = of_lamps(light_of("same_carrier_0.3", MODULATED, MANY) - clear)
    share = added / (0.3 * beside)
    np.testing.assert_allclose(share, share[..., :1, :1] + np.zeros((5, 5)), atol=1e-9)
    phases = np.arccos(np.clip(share[:, 0, 0, 0], -1, 1)) / np.pi
    assert stats.kstest(phases, "uniform").pvalue > 1e-3
    assert np.abs(share[:, 1:]).max() < 0.01  # the other carriers
    # Off the carrier a sinc is left, as of the window of a frame.
    off = of_lamps(light_of("other_carrier_0.3", MODULATED, MANY) - clear)
    most = np.abs(off / (0.3 * beside)).max(axis=(0, 2, 3))
    np.testing.assert_allclose(most, np.abs(np.sinc(3.7 - np.arange(3))), atol=0.01)


@pytest.mark.parametrize("carrier_hz", [1000, 40])
def test_waves_leak_less_the_faster_the_lamps_are_modulated(carrier_hz):
    dark = np.tile([-1e6, 0, 0, 0, 0], (500, 1))
    leaks = of_lamps(light_of(f"waves_{carrier_hz}", MODULATED, dark)) - 20.0
    # The wave times the reference, a sine, by the integral of a tone over a frame of 0.1 s.
    carriers = carrier_hz + 10 * np.arange(3)
    off = 5 + np.array([carriers, -carriers])
    tones = np.exp(1j * np.pi * 0.1 * off) * np.sinc(0.1 * off)
    largest = 120 * np.pi / 2 * np.abs(tones[0] - tones[1]) / 2
    np.testing.assert_allclose(np.abs(leaks).max(axis=(0, 2, 3)), largest, rtol=0.01)
