"""What feeds the live view: the simulation and its sliders, a recording and its time line."""

import signal
import sys
import threading
from queue import Empty, SimpleQueue

import numpy as np
import pytest
from command_line import begun, ended
from scenes import squared_error

from uuv_optical_array.control.following import State
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.view import recorded
from uuv_optical_array.view.closed_loop import Conditions
from uuv_optical_array.view.recorded import Player, sights_of
from uuv_optical_array.view.simulation import chosen, simulate, sliders


class Paper:
    """A page that keeps what it is to show."""

    def __init__(self):
        self.seen, self.sliders, self.buttons = [], None, {}

    def show(self, sight):
        self.seen.append(sight)

    def add_sliders(self, title, sliders, on_change):
        self.sliders, self.on_change = sliders, on_change

    def add_button(self, label, on_click):
        self.buttons[label] = on_click


@pytest.mark.parametrize("powers", [(1.5,), (1.0, 0.0, 0.5)])
def test_sliders_and_conditions_are_each_others_inverse(powers):
    conditions = Conditions(0.2, powers, 0.7, (0.1, -0.2, 0.0), (-5.0, 0.3, -0.1))
    assert chosen([slider.value for slider in sliders(conditions)]) == conditions
    for slider in sliders(conditions):
        assert slider.low <= slider.value <= slider.high, slider.label


@pytest.mark.parametrize(("dims", "clear"), [("attenuation", "0.05"), ("absorption", "0.114")])
def test_the_slider_of_the_water_says_what_measured_waters_have(dims, clear):
    hint = sliders(Conditions(0.2), dims)[0].hint
    assert f"{clear} clear ocean" in hint  # Eren et al. (2016), Petzold (1972)


def test_sliders_act_between_two_steps_and_a_button_begins_again(table):
    paper = Paper()
    estimator = Estimator(table, "sam", max_angle_rad=0.0)

    def goes_on(t_s):
        if len(paper.seen) == 3:
            paper.on_change(
                [slider.value * (slider.label != "lamp power") for slider in paper.sliders]
            )
        if len(paper.seen) == 5:
            paper.buttons["start again"]()
        return len(paper.seen) < 7

    simulate(paper, estimator, 1, goes_on)
    peaks = [sight.image.max() for sight in paper.seen]
    assert min(peaks[:3]) > 50 > 10 > max(peaks[3:])  # counts; only noise without the lamp
    np.testing.assert_allclose(
        [sight.t_s for sight in paper.seen], [0.1, 0.2, 0.3, 0.4, 0.5, 0.1, 0.2]
    )
    assert [sight.lit for sight in paper.seen] == [(True,)] * 3 + [(False,)] * 4
    assert [sight.state.name for sight in paper.seen] == ["waiting"] * 7
    assert paper.seen[-1].note.startswith("no light")
    assert paper.seen[0].pose is None
    assert paper.seen[0].true_pose[0] == pytest.approx(-5.0)  # half a metre off the station


@pytest.mark.parametrize(
    ("name", "label"), [("reference", "attenuation (1/m)"), ("follow", "absorption (1/m)")]
)
def test_the_slider_of_the_water_is_called_what_the_scene_has(name, label):
    paper = Paper()
    estimator = Estimator(load_scene(name), compiled=False)
    simulate(paper, estimator, 1, lambda t_s: False)
    assert paper.sliders[0].label == label
    assert paper.sliders[0].value == estimator.scene.attenuation[1]


@pytest.mark.usefixtures("compiled_fit")
def test_a_recording_is_shown_with_the_truth_that_it_has(scene, table):
    rng = np.random.default_rng(2)
    poses = np.array([[-6 + 0.05 * i, 0.1, 0.0, 0.0, 0.05] for i in range(6)])
    images = ForwardModel(scene).expose(poses, rng)
    images[4] = 0
    truth = poses.copy()
    truth[1] = np.nan
    stamps = 10**18 + 10**8 * np.arange(6)
    recording = Recording(images, truth, np.zeros(6), stamps)
    told = [(1.15, "waiting"), (1.3, "locked"), (2.0, "coasting")]
    recording.states[:] = [State(name, 10**9 - 1 + since, "so") for since, name in told]
    seen = list(sights_of(recording, Estimator(table)))
    states = [sight.state and sight.state.name for sight in seen]
    assert states == [None, None, "waiting", "locked", "locked", "locked"]
    assert seen[3].state.since_s == pytest.approx(0.3, abs=1e-6)
    np.testing.assert_allclose([sight.t_s for sight in seen], 0.1 * np.arange(6), atol=1e-6)
    assert [sight.true_pose is None for sight in seen] == [False, True, *[False] * 4]
    assert [sight.pose is None for sight in seen] == [*[False] * 4, True, False]
    assert seen[4].note.startswith("no light")
    for sight, pose in zip(seen, poses, strict=True):
        if sight.pose is not None:
            assert squared_error(sight, pose) < 30  # chi-square of 5: 1.5e-5


def test_the_time_line_jumps_pauses_and_runs_to_the_end():
    player = Player([0.0, 0.01, 0.02, 0.03])
    assert [player.next() for _ in range(3)] == [(0, True), (1, False), (2, False)]
    player.choose(0.015, True)
    assert [player.next() for _ in range(3)] == [(1, True), (2, False), (3, False)]
    player.choose(0.02, False)
    assert player.next() == (2, True)
    # Paused, and at the end, it waits for a choice.
    for t_s, runs, at in ((0.01, False, 1), (99.0, True, 3), (-1.0, False, 0)):
        waits = threading.Timer(0.05, player.choose, (t_s, runs))
        waits.start()
        assert player.next() == (at, True)


def test_a_page_that_was_slow_shows_the_next_images_at_their_pace_not_all_at_once(monkeypatch):
    now_s = 100.0

    class Choices(SimpleQueue):
        """Waits by the clock of the test."""

        def get(self, timeout=None):
            nonlocal now_s
            if self.empty():
                now_s += timeout
                raise Empty
            return super().get()

    monkeypatch.setattr(recorded, "SimpleQueue", Choices)
    player = Player([0.0, 0.02, 0.04, 0.06], lambda: now_s)
    assert player.next() == (0, True)
    now_s += 5.0  # in which it was shown
    shown = [(player.next(), now_s) for _ in range(3)]
    assert [place for place, _ in shown] == [(1, False), (2, False), (3, False)]
    np.testing.assert_allclose([at_s for _, at_s in shown], [105.0, 105.02, 105.04])


@pytest.mark.usefixtures("compiled_fit")
def test_ctrl_c_ends_the_command_in_a_line(scene_file):
    pytest.importorskip("viser", reason="the view needs the extra view")
    words = ["view", "--scene", scene_file, "--address", ":18200"]
    code = "from uuv_optical_array.programs import uuv_array; uuv_array()"
    with begun([sys.executable, "-c", code, *words]) as process:
        assert process.stdout.readline().startswith("open http://127.0.0.1:18")
        process.send_signal(signal.SIGINT)
        assert ended(process, 130) == ("", "interrupted\n")
