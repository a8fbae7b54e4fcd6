"""An estimator answers at once by the fit as it stands, and later by the compiled one."""

import fcntl
import importlib.util
import os
import re
import select
import shutil
import signal
import sys

import numpy as np
import pytest
from command_line import begun, python
from conftest import PATIENCE_S
from needs import numba
from scenes import assert_same_estimate

from uuv_optical_array.core.numerics import background, compilation
from uuv_optical_array.estimation import fit_compiler
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.least_squares.image_fit import ImageFit
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

POSES = [[-6, 0.2, -0.1, 0.05, -0.1], [-5, -0.2, 0.1, -0.05, 0.1]]


@pytest.fixture
def nothing_loaded(monkeypatch):
    """Let this process look as one that finds no compiled fit."""
    monkeypatch.setattr(background, "is_compiled", lambda mark: False)
    fit_compiler.fit_compiler.cache_clear()
    yield
    fit_compiler.fit_compiler.cache_clear()


@pytest.fixture
def images(scene):
    return ForwardModel(scene).expose(POSES, np.random.default_rng(9))


@numba
def test_it_answers_as_it_stands_until_the_compiled_fit_takes_over(
    tmp_path, monkeypatch, compiled_fit, nothing_loaded, scene, images
):
    # A compiler that works as long as the lock is held.
    gate = tmp_path / "gate"
    code = f"import fcntl; fcntl.flock(open({str(gate)!r}), fcntl.LOCK_SH)"
    monkeypatch.setattr(background, "CODE", code)
    plain = Estimator(scene, compiled=False)
    with gate.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        estimator = Estimator(scene)
        assert_same_estimate(estimator.estimate(images[0]), plain.estimate(images[0]))
        assert estimator.state_of_fit == "as it stands: it is being compiled"
    assert estimator.wait() is estimator
    assert estimator.state_of_fit == "compiled"
    assert_same_estimate(estimator.estimate(images[1]), plain.estimate(images[1]))


@numba
@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise OSError('disk full')", "OSError: disk full"),
        ("import os; os._exit(3)", "exit code 3"),
        ("import os; os.write(2, b'no \\xff'); os._exit(3)", "no \ufffd"),
    ],
)
@pytest.mark.usefixtures("nothing_loaded")
def test_where_the_compiler_fails_the_fit_as_it_stands_goes_on(
    monkeypatch, scene, images, code, reason
):
    monkeypatch.setattr(background, "CODE", code)
    estimator = Estimator(scene).wait()
    assert estimator.state_of_fit == f"as it stands: {reason}"
    assert_same_estimate(
        estimator.estimate(images[0]), Estimator(scene, compiled=False).estimate(images[0])
    )


@pytest.mark.usefixtures("nothing_loaded")
def test_without_numba_the_fit_as_it_stands_answers(monkeypatch, scene, images):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "numba" else find(name)
    )
    estimator = Estimator(scene)
    assert estimator.state_of_fit == "as it stands: Numba is not installed"
    assert np.isfinite(estimator.wait().estimate(images[0]).pose).all()


@numba
def test_the_first_frame_of_a_track_takes_one_fit_as_any_other(monkeypatch):
    fit, fits = ImageFit.__call__, []
    pipeline = Pipeline(Estimator(load_scene("follow")).wait())

    def counted(*given):
        fits.append(given)
        return fit(*given)

    monkeypatch.setattr(ImageFit, "__call__", counted)
    images = ForwardModel(load_scene("follow")).expose(POSES, np.random.default_rng(9))
    for count, image in enumerate(images, 1):
        assert pipeline.estimate(count * 10**10, image).readings is not None
        assert len(fits) == count


STATE = """
import sys
from uuv_optical_array.core.numerics.compilation import compiled
from uuv_optical_array.estimation.least_squares.frame import estimate_frame
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.estimation.estimator import Estimator
print(Estimator(load_scene(sys.argv[1])).wait().state_of_fit)
stats = compiled(estimate_frame).stats
print(len(stats.cache_hits), len(stats.cache_misses))
"""


def run(program, *words, **environment):
    return python(program, *words, env={**os.environ, **environment})


@numba
def test_the_process_fills_the_cache_from_which_others_load(scene_file):
    ran = run(STATE, scene_file)
    assert re.fullmatch(r"compiled\n[1-9]\d* 0\n", ran.stdout), (ran.stdout, ran.stderr)


DAMAGED = """
import sys
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
scene = load_scene(sys.argv[1])
estimator = Estimator(scene)
image = ForwardModel(scene).expected([-6, 0.2, -0.1, 0.05, -0.1])
print(estimator.state_of_fit, *estimator.estimate(image).pose)
"""


@numba
def test_where_a_kept_file_is_damaged_the_fit_as_it_stands_goes_on_while_it_is_compiled_anew(
    tmp_path, compiled_fit, scene_file, scene
):
    kept = compilation.cache_folder()
    folder = tmp_path / "compiled" / kept.name
    shutil.copytree(kept, folder)
    (code,) = folder.glob("*/frame.estimate_frame-*.nbc")
    content = bytearray(code.read_bytes())
    content[len(content) // 2] ^= 16
    code.write_bytes(content)
    ran = run(DAMAGED, scene_file, NUMBA_CACHE_DIR=str(tmp_path))
    state, _, pose = ran.stdout.partition("compiled ")
    assert state == "as it stands: it is being "
    assert re.search(rf"{folder}: .* compiled again", ran.stderr), ran.stderr
    expected = Estimator(scene, compiled=False).estimate(ForwardModel(scene).expected(POSES[0]))
    np.testing.assert_allclose([float(x) for x in pose.split()], expected.pose)


@numba
def test_where_nothing_can_be_kept_the_reason_has_the_cure(tmp_path):
    occupied = tmp_path / "file"
    occupied.touch()
    program = "from uuv_optical_array.estimation.fit_compiler import compile_fit; compile_fit()"
    ran = run(program, NUMBA_CACHE_DIR=str(occupied))
    assert ran.returncode == 1
    assert "NUMBA_CACHE_DIR" in ran.stderr.splitlines()[-1]


# The compiler and the program that waits for it each write a letter.
PROGRAM = """
from uuv_optical_array.core.numerics import background
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.scene import load_scene
background.is_compiled = lambda mark: False
background.CODE = (
    "import sys, threading; sys.path[:] = {{path!r}}; from {{here}} import fill_cache; "
    "letters = open({fifo!r}, 'w'); letters.write('c'); letters.flush(); "
    "fill_cache(threading.Event().wait)"
)
letters = open({fifo!r}, "w")
try:
    estimator = Estimator(load_scene({scene!r}))
    letters.write("p")
    letters.flush()
    estimator.wait()
except KeyboardInterrupt:
    pass
"""


@numba
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_compiling_process_ends_with_the_program(tmp_path, scene_file, number):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    ear = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)

    def heard():
        """Wait for letters; none once both processes are gone."""
        assert select.select([ear], [], [], PATIENCE_S)[0], "no letter, and nobody has ended"
        return os.read(ear, 100)

    program = PROGRAM.format(fifo=str(fifo), scene=scene_file)
    # Not by a pipe: the compiler that is to end with the program has it open, too.
    log, code = tmp_path / "log", 0 if number == signal.SIGINT else -number
    words = [sys.executable, "-c", program]
    with log.open("w") as file, begun(words, stdout=file, stderr=file) as process:
        letters = b""
        while set(letters) != set(b"cp"):
            letters += heard()
        process.send_signal(number)
        assert process.wait(PATIENCE_S) == code, log.read_text()
        assert "Traceback" not in log.read_text()
        assert heard() == b""
    os.close(ear)
