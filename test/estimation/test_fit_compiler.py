"""The start: frames are answered while the fit is compiled beside the node, and none is lost."""

import fcntl
import importlib.util
import os
import select
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from asker import Shower, assert_is, figures
from builtin_interfaces.msg import Time
from conftest import PATIENCE_S
from diagnostic_msgs.msg import DiagnosticStatus

from uuv_optical_array.estimation import fit_compiler
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.least_squares.image_fit import ImageFit
from uuv_optical_array.estimation.table.signature_table import build_table, coarse_scene
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
NUMBA = pytest.mark.skipif(
    importlib.util.find_spec("numba") is None, reason="numba is not installed: nothing to compile"
)


@pytest.fixture
def nothing_loaded(monkeypatch):
    """Let this process look as one that has loaded no compiled fit."""
    monkeypatch.setattr(fit_compiler, "LOADED", set())
    monkeypatch.setattr(fit_compiler, "is_compiled", lambda scene: False)


@pytest.fixture
def gate(tmp_path, monkeypatch, nothing_loaded):
    """A compiler that works until the returned function is called."""
    path = tmp_path / "gate"
    # A lock, which also lets through who comes after it was opened.
    monkeypatch.setattr(
        fit_compiler, "CODE", f"import fcntl; fcntl.flock(open({str(path)!r}), fcntl.LOCK_SH)"
    )
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield lock.close


@pytest.fixture(scope="module")
def images(scene):
    rng = np.random.default_rng(9)
    poses = rng.uniform([-7.5, -0.4, -0.4, -0.2, -0.2], [-4.5, 0.4, 0.4, 0.2, 0.2], (4, 5))
    return ForwardModel(scene).expose(poses, rng)


def begun(lab, scene_file, scene, table_folder):
    return Shower(lab, scene_file, scene, table=table_folder, method="least_squares")


@NUMBA
@pytest.mark.usefixtures("compiled_fit")
def test_every_frame_is_answered_before_and_after_the_compiled_fit_takes_over(
    gate, lab, scene_file, scene, table_folder, table, images
):
    shower = begun(lab, scene_file, scene, table_folder)
    meanwhile = Estimator(table, "least_squares", compiled=False, quick=True)
    fit = Estimator(table, "least_squares")

    def expected(estimator, image):
        return estimator.estimate(image, shower.signature(image))

    assert_is(shower.show(images[0], 1), expected(meanwhile, images[0]))
    assert_is(shower.show(images[1], 2), expected(meanwhile, images[1]))
    told = lab.report(shower.node, WARN, "compiling", "quick fit answers", value="method")
    values = dict(figures(told))
    assert (values["method"], values["fit"]) == ("least_squares", "quick, until it is compiled")
    # One image is there when the fit takes over, and its signature comes after.
    shower.images.publish(shower.picture(images[2], 3))
    lab.until(lambda: 3 * 10**9 + 9 in shower.node.pairs.waiting, "the image")
    gate()
    lab.until(lambda: not shower.node.estimator.quick, "the fit")
    shower.clouds.publish(shower.message(shower.signature(images[2]), 3))
    message = lab.answer(shower.poses, Time(sec=3, nanosec=9), "a pose")
    assert_is(message, expected(fit, images[2]))
    assert_is(shower.show(images[3], 4), expected(fit, images[3]))
    assert shower.seconds_answered() == [1, 2, 3, 4]
    lab.statuses.clear()
    shower.show(images[0], 5)
    values = dict(figures(lab.report(shower.node, OK)))
    assert (values["method"], values["fit"]) == ("least_squares", "compiled")


@NUMBA
@pytest.mark.usefixtures("compiled_fit")
def test_what_is_compiled_already_is_loaded_before_the_first_frame_and_no_search_is_built(
    lab, scene_file, scene, table_folder, images, monkeypatch
):
    monkeypatch.setattr(fit_compiler, "LOADED", set())
    shower = begun(lab, scene_file, scene, table_folder)
    assert shower.node.compiler.done
    assert not shower.node.estimator.quick
    shower.show(images[0], 1)
    assert "index" not in vars(shower.node.table)  # a second, in a table of the usual size


@NUMBA
def test_the_first_frame_takes_one_fit_as_any_other(monkeypatch):
    # Of its images a track takes the readings, where they are linear enough.
    calibrated = coarse_scene(load_scene("follow"))
    done, fit, fits = threading.Event(), ImageFit.__call__, []
    compiler = fit_compiler.FitCompiler(calibrated, done.set)
    compiler.start()
    assert compiler.done or done.wait(PATIENCE_S)
    estimator = compiler.estimator(build_table(calibrated), method="least_squares")

    def counted(*given):
        fits.append(given)
        return fit(*given)

    monkeypatch.setattr(ImageFit, "__call__", counted)
    poses = [[-6, 0.2, -0.1, 0.05, -0.1], [-5, -0.2, 0.1, -0.05, 0.1]]
    images = ForwardModel(calibrated).expose(poses, np.random.default_rng(9))
    expected = Tracker(TrackerSettings(), constants=estimator.constants).expected(0)
    for count, image in enumerate(images, 1):
        assert estimator.estimate(image, expected=expected).readings is not None
        assert len(fits) == count


@NUMBA
@pytest.mark.usefixtures("compiled_fit")
def test_without_ros_too_a_quick_fit_answers_until_the_whole_one_takes_over(
    table, images, monkeypatch
):
    monkeypatch.setattr(fit_compiler, "is_compiled", lambda scene: False)
    monkeypatch.setattr(fit_compiler.FitCompiler, "start", lambda self: None)  # never done
    ready = fit_compiler.ReadyEstimator(table, "least_squares")
    found = ready().estimate(images[0])
    expected = Estimator(table, compiled=False, quick=True).estimate(images[0])
    np.testing.assert_array_equal(found.pose, expected.pose)
    ready._compiler.done = True
    found, expected = (each.estimate(images[0]) for each in (ready(), Estimator(table)))
    np.testing.assert_array_equal(found.pose, expected.pose)
    assert ready() is ready()
    ready.stop()


@NUMBA
def test_other_methods_compile_nothing_until_the_fit_is_asked_for(
    gate, lab, scene_file, scene, table_folder, images
):
    shower = Shower(lab, scene_file, scene, table=table_folder, method="sam")
    shower.show(images[0], 1)
    lab.report(shower.node, OK)
    assert shower.node.compiler._process is None
    assert lab.set(shower.node, "method", "least_squares").successful
    shower.show(images[1], 2)
    lab.report(shower.node, WARN, "compiling")
    assert lab.set(shower.node, "method", "sam").successful
    shower.show(images[2], 3)
    lab.statuses.clear()
    lab.report(shower.node, OK)


def plain(lab, shower, table, images, reason):
    """Require the fit without the compiler, and the reason in the diagnostics."""
    lab.until(lambda: not shower.node.estimator.quick, "the fit")
    estimator = Estimator(table, "least_squares", compiled=False)
    for seconds, image in enumerate(images[:2], start=1):
        answer = estimator.estimate(image, shower.signature(image))
        assert_is(shower.show(image, seconds), answer)
    lab.statuses.clear()
    shower.show(images[2], 3)
    values = dict(figures(lab.report(shower.node, OK)))
    assert values["fit"] == f"not compiled: {reason}"


@NUMBA
@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise OSError('disk full')", "OSError: disk full"),
        ("import os; os._exit(3)", "exit code 3"),
    ],
)
@pytest.mark.usefixtures("nothing_loaded")
def test_where_the_compiler_fails_the_plain_fit_answers_and_the_reason_is_told(
    lab, scene_file, scene, table_folder, table, images, monkeypatch, code, reason
):
    monkeypatch.setattr(fit_compiler, "CODE", code)
    shower = begun(lab, scene_file, scene, table_folder)
    plain(lab, shower, table, images, reason)


@pytest.mark.usefixtures("nothing_loaded")
def test_without_numba_the_plain_fit_answers_and_the_reason_is_told(
    lab, scene_file, scene, table_folder, table, images, monkeypatch
):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "numba" else find(name)
    )
    shower = begun(lab, scene_file, scene, table_folder)
    plain(lab, shower, table, images, "Numba is not installed")


def run(program, **environment):
    return subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        env={**os.environ, **environment},
        check=False,
    )


COMPILED = """
import threading
from uuv_optical_array.core.numerics.compilation import compiled
from uuv_optical_array.estimation.least_squares.frame import estimate_frame
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.estimation.fit_compiler import FitCompiler
done = threading.Event()
compiler = FitCompiler(load_scene({scene!r}), done.set)
compiler.start()
done.wait()
assert compiler.done and not compiler.failure, compiler.failure
stats = compiled(estimate_frame).stats
print(len(stats.cache_hits), len(stats.cache_misses))
"""


@NUMBA
def test_the_process_fills_the_cache_from_which_the_node_loads(scene_file):
    ran = run(COMPILED.format(scene=scene_file))
    assert ran.returncode == 0, ran.stderr
    hits, misses = map(int, ran.stdout.split())
    assert hits > 0
    assert misses == 0


@NUMBA
def test_where_nothing_can_be_kept_the_reason_is_told_with_the_cure(tmp_path, scene):
    occupied = tmp_path / "file"
    occupied.touch()
    program = (
        "from uuv_optical_array.estimation.fit_compiler import compile_fit; "
        "from uuv_optical_array.forward.scene import scene_from_settings; "
        f"compile_fit(scene_from_settings({scene.settings()!r}, 'small'))"
    )
    ran = run(program, NUMBA_CACHE_DIR=str(occupied))
    assert ran.returncode == 1
    assert "NUMBA_CACHE_DIR" in ran.stderr.splitlines()[-1]


@NUMBA
def test_the_process_finds_all_that_the_node_finds(
    monkeypatch, nothing_loaded, compiled_fit, scene
):
    """ROS's own libraries too, which its wheels find by two variables of the environment."""
    code = "import sys; sys.path[:] = {path!r}; import rclpy, {module}"
    monkeypatch.setattr(fit_compiler, "CODE", code)
    done = threading.Event()
    compiler = fit_compiler.FitCompiler(scene, done.set)
    compiler.start()
    assert done.wait(PATIENCE_S)
    assert compiler.failure == ""


# The compiler and the node, once it serves callbacks, each write a letter.
NODE = """
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.estimation import fit_compiler
from uuv_optical_array.nodes.shared import node
fit_compiler.is_compiled = lambda scene: False
fit_compiler.CODE = (
    "import sys, threading; sys.path[:] = {{path!r}}; import {{module}} as module; "
    "tell = open({fifo!r}, 'w'); tell.write('c'); tell.flush(); "
    "module.compile_fit = lambda scene: threading.Event().wait(); "
    "module.fill_cache({{settings!r}})"
)
tell = open({fifo!r}, "w")

class Told(EstimatorNode):
    def __init__(self):
        super().__init__()
        self.once = self.create_timer(0.001, self.on_once)

    def on_once(self):
        self.once.cancel()
        tell.write("n")
        tell.flush()

node.run(Told, ["--ros-args", "-p", "scene:={scene}"])
"""


@NUMBA
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_process_ends_with_the_node(tmp_path, scene_file, number):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    ear = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)

    def heard():
        """Wait for letters; none once both processes are gone."""
        assert select.select([ear], [], [], PATIENCE_S)[0], "nothing is said, nobody has ended"
        return os.read(ear, 100)

    with (tmp_path / "log").open("w") as log:
        node = subprocess.Popen(
            [sys.executable, "-c", NODE.format(fifo=str(fifo), scene=scene_file)], stderr=log
        )
    try:
        begun = b""
        while set(begun) != set(b"cn"):
            begun += heard()
        node.send_signal(number)
        code, errors = node.wait(PATIENCE_S), (tmp_path / "log").read_text()
        assert code == (-number if number == signal.SIGKILL else 0), errors
        assert "Traceback" not in errors
        assert heard() == b""
    finally:
        node.kill()
        node.wait()
        os.close(ear)


@NUMBA
def test_the_process_ends_at_the_shutdown_of_a_program_that_goes_on(
    gate, lab, scene_file, scene, table_folder
):
    process = begun(lab, scene_file, scene, table_folder).node.compiler._process
    assert process.poll() is None
    lab.end()
    assert process.returncode == -signal.SIGKILL


@NUMBA
def test_a_stopped_compiler_calls_nothing(gate, scene):
    called = []
    compiler = fit_compiler.FitCompiler(scene, lambda: called.append(1))
    compiler.start()
    compiler.stop()
    assert compiler._process.returncode == -signal.SIGKILL
    gate()
    assert not compiler.done
    assert called == []
