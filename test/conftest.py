"""A test run has a ROS domain, cache and log of its own; a Lab holds nodes and a probe."""

import contextlib
import functools
import gc
import importlib.util
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import hypothesis
import pytest

PATIENCE_S = 600.0  # only a failure takes so long, on however busy a machine
SCRATCH = tempfile.TemporaryDirectory(prefix="uuv_optical_array_test_")

# What only some machines have. launch_testing imports every module below this folder, and
# collects none of them where one skips itself.
NEEDS = {
    "nodes/bringup/test_launch.py": ("launch_ros", "launch_testing", "launch_testing_ros"),
    "forward/test_scene_schema.py": ("jsonschema",),
    "studies/test_photon_transport.py": ("numba",),
    "examples/test_firmware.py": ("serial", "cobs"),
    "examples/test_rehearsal.py": ("serial", "cobs"),
    "examples/test_serial_array.py": ("serial", "cobs"),
    "view/test_guard.py": ("viser",),
    "view/test_view.py": ("viser",),
    "nodes/test_view_node.py": ("viser",),
}
LEFT_OUT = {
    file: f"{module} is not installed"
    for file, modules in NEEDS.items()
    for module in modules
    if importlib.util.find_spec(module) is None
}
collect_ignore = list(LEFT_OUT)


def pytest_terminal_summary(terminalreporter):
    for file, reason in LEFT_OUT.items():
        terminalreporter.write_line(f"LEFT OUT {file}: {reason}")


# Every run tries the same examples; `pytest --hypothesis-profile=search` looks for new ones. None
# fails because the machine is busy.
UNTIMED = {"deadline": None, "suppress_health_check": [hypothesis.HealthCheck.too_slow]}
hypothesis.settings.register_profile("search", **UNTIMED)
hypothesis.settings.register_profile("same", derandomize=True, **UNTIMED)
hypothesis.settings.load_profile("same")
# It also draws numbers from whichever modules are loaded by then, which differs between workers.
with contextlib.suppress(ImportError):  # older ones do not
    from hypothesis.internal.conjecture import providers

    providers._get_local_constants = lambda: providers._local_constants

DOMAIN = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)


def domains_in_use():
    """Return the ROS domains that processes of this machine were started in.

    A run that is killed frees its claim, and may leave nodes that go on answering.
    """
    found = set()
    for variables in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):  # it has ended, or is another user's
            found |= {*re.findall(rb"(?:^|\0)ROS_DOMAIN_ID=(\d+)", variables.read_bytes())}
    return {int(domain) for domain in found}


def free_domain():
    """Claim a ROS domain for as long as this process lives, against any other test run.

    The claim is an abstract socket: the kernel lets one process have it, and leaves no file.
    """
    used = domains_in_use()
    for domain in range(1, 102):
        if domain in used:
            continue
        try:
            DOMAIN.bind(f"\0uuv_optical_array_test_{domain}")
        except OSError:
            continue
        return domain
    raise RuntimeError("no ROS domain from 1 to 101 is free; end some of the other test runs")


# Before any test module starts ROS, and for every process that a test starts.
os.environ.update(
    ROS_DOMAIN_ID=str(free_domain()),
    ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
    ROS_LOG_DIR=f"{SCRATCH.name}/log",
    XDG_CACHE_HOME=f"{SCRATCH.name}/cache",
)
# What is compiled is the same for every run of the same sources, and for all workers of a run.
os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache"))
# Without bytecode every worker and every process of a test would compile all sources again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# A shell ignores Ctrl-C for what it starts in the background, and so would every process of a test.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# Modules of tests that fit images come last in each worker. Where all tests run in several
# processes, the idle one compiles the fit meanwhile; else every worker would wait for one of them.
FITTING = re.compile(
    "test_(acceptance|accuracy|advise|approach|bag_of_lamps|beam|benchmarks|closed_loop|"
    "code_blocks|commands|demo|drives|elementwise|end_to_end|envelope|estimate|estimator_node|"
    "every_effect|example_scripts|examples|faults|film|fit|fit_compiler|follower_node|fuzz|"
    "hard_cases|lattice|light_tables|linearised|loop_of_nodes|many_poses|misfit|mixture|"
    "near_frames|node_parameters|notebook|outputs|paper|places|plausibility|poses|posterior|"
    "programs|ranges|readme_figures|record|reference|rehearsal|replay|robustness|security|"
    "several_lamps|signature_table|track_of_images|tracking_constants|tracking_manoeuvres|"
    "tracking_seas|tracking_shades|tradeoff|transport|uneven_light|view|view_sources)"
)
COMPILE = "from uuv_optical_array.estimation.fit_compiler import compile_fit; compile_fit()"
COMPILER = []


def pytest_sessionstart(session):
    config = session.config
    whole = config.args_source is config.ArgsSource.TESTPATHS
    if whole and config.pluginmanager.hasplugin("dsession"):
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        COMPILER.append(subprocess.Popen([sys.executable, "-c", COMPILE], **quiet))


def pytest_collection_modifyitems(items):
    groups = [], []
    for item in items:
        groups[FITTING.fullmatch(item.path.stem) is not None].append(item)
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    # Each worker begins with a part of its own, of as many tests as those of the others.
    items[:] = [
        item
        for part in range(workers)
        for group in groups
        for item in group[part * len(group) // workers : (part + 1) * len(group) // workers]
    ]


def pytest_collection_finish():
    gc.freeze()  # what was collected lasts, and is not looked at again and again


def pytest_unconfigure():
    for process in COMPILER:
        process.kill()
        process.wait()
    SCRATCH.cleanup()
    DOMAIN.close()


def of_a_kind(name):
    """Return a method of the diagnostics that takes no text but those in the list of reasons."""
    from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
    from uuv_optical_array.nodes.shared.reasons import kind_of

    told = getattr(Diagnostics, name)

    def tell(self, *reasons):
        ours = type(self._node).__module__.startswith("uuv_optical_array.")  # no example
        for reason in filter(None, reasons):
            assert not ours or kind_of(reason), f"in no list of reasons: {reason}"
        told(self, *reasons)

    return tell


class Lab:
    """Nodes under test and a probe node in one executor; tests await events, they never sleep."""

    def __init__(self):
        self.nodes, self.statuses = [], []
        self.publishers, self.subscriptions = [], []
        self.patch = pytest.MonkeyPatch()

    def begin(self, parameters=None, *arguments, any_stamp=True):
        """Start ROS with start parameters, such as ``{"feature_node:scene": "reference"}``.

        Stamps of tests are mostly not of the clock.
        """
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor
        from rosgraph_msgs.msg import Clock

        from uuv_optical_array.nodes.shared import diagnostics

        for name in ("refuse", "warn", "fail"):
            self.patch.setattr(diagnostics.Diagnostics, name, of_a_kind(name))
        if any_stamp:
            self.patch.setattr(diagnostics, "ACCEPTABLE_AGE_S", (-math.inf, math.inf))
        given = [
            word
            for name, value in (parameters or {}).items()
            for word in ("-p", f"{name}:={json.dumps(value)}")
        ]
        rclpy.init(args=["--ros-args", *map(str, arguments), *given])
        self.executor = SingleThreadedExecutor()
        self.probe = rclpy.create_node("probe", use_global_arguments=False)
        self.executor.add_node(self.probe)
        self.subscribe(
            DiagnosticArray, "/diagnostics", lambda array: self.statuses.extend(array.status)
        )
        if (parameters or {}).get("use_sim_time"):
            self.clock = self.talk(Clock, "/clock")

    def end(self):
        import rclpy

        self.patch.undo()
        if hasattr(self, "executor"):
            self.executor.shutdown()
            for node in (*self.nodes, self.probe):
                node.destroy_node()
        rclpy.try_shutdown()

    def start(self, node_type, namespace=None, reports=False):
        """Start a node, as ``__ns:=NAMESPACE`` does in a process of its own.

        Unless it reports by itself, a period of its diagnostics ends when `report` asks for it, so
        that what a status holds does not depend on the machine.
        """
        from rclpy.node import Node

        with pytest.MonkeyPatch.context() as patch:
            if namespace:
                inside = functools.partialmethod(Node.__init__, namespace=namespace)
                patch.setattr(Node, "__init__", inside)
            node = node_type()
        if hasattr(node, "diagnostics") and not reports:
            node.diagnostics.timer.cancel()
        self.executor.add_node(node)
        self.nodes.append(node)
        return node

    def subscribe(self, message_type, topic, callback):
        self.subscriptions.append(
            self.probe.create_subscription(message_type, topic, callback, 100)
        )

    def listen(self, message_type, topic):
        """Return a list that grows by every message on a topic."""
        heard = []
        self.subscribe(message_type, topic, heard.append)
        return heard

    def listen_late(self, message_type, topic):
        """Return a list that grows by every message on a topic, those from before too."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        heard = []
        lasting = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.probe.create_subscription(message_type, topic, heard.append, lasting)
        return heard

    def logged(self, words):
        """Wait for a line of the log with some words; return all lines until then."""
        from rcl_interfaces.msg import Log

        lines = self.listen_late(Log, "/rosout")
        self.until(lambda: any(words in line.msg for line in lines), f"{words} in the log")
        return lines

    def talk(self, message_type, topic):
        """Return a publisher."""
        self.publishers.append(self.probe.create_publisher(message_type, topic, 100))
        return self.publishers[-1]

    def connect(self):
        """Wait until the probe and the nodes under test hear each other on every topic."""
        ours = {talker.topic_name for talker in self.publishers}
        heard = {ear.topic_name for ear in self.subscriptions}

        def connected():
            nodes = [self.probe, *self.nodes]
            talkers = [talker for node in nodes for talker in node.publishers]
            ears = [ear for node in nodes for ear in node.subscriptions]
            wanted_ears = [ear for ear in ears if ear.topic_name in ours | heard]
            wanted_talkers = [talker for talker in talkers if talker.topic_name in ours | heard]
            return all(
                talker.get_subscription_count()
                >= sum(ear.topic_name == talker.topic_name for ear in ears)
                for talker in wanted_talkers
            ) and all(
                ear.handle.get_publisher_count()
                >= max(1, sum(talker.topic_name == ear.topic_name for talker in talkers))
                for ear in wanted_ears
            )

        self.until(connected, "probe and nodes to find each other")

    def until(self, condition, what):
        """Spin until a condition holds and return what it returned."""
        deadline = time.monotonic() + PATIENCE_S
        while not (result := condition()):
            assert time.monotonic() < deadline, f"waited {PATIENCE_S:g} s for {what}"
            self.executor.spin_once(timeout_sec=0.05)
        return result

    def deliver(self, node, talker, message):
        """Publish a message and wait until the node has answered or refused it."""
        totals = node.diagnostics.totals
        before = sum(totals.values())
        talker.publish(message)
        self.until(lambda: sum(totals.values()) > before, "the message to arrive")

    def answer(self, heard, stamp, what="an answer"):
        """Wait for the message with a stamp, whatever was heard before."""
        return self.until(
            lambda: next((message for message in heard if message.header.stamp == stamp), None),
            f"{what} with {stamp}",
        )

    def report(self, node, level, *words, value=None):
        """Wait for a diagnostic status of a node, without waiting for its period to end.

        A value that it must have is named where it comes after the pose, with what else there is.
        """
        name = node.get_fully_qualified_name().lstrip("/")

        def found():
            for status in self.statuses:
                wanted = status.name == name and status.level == level
                has = value is None or any(pair.key == value for pair in status.values)
                if wanted and has and all(word in status.message for word in words):
                    return status
            node.diagnostics.publish()
            return None

        status = self.until(found, f"{name} to report {level!r} with {words}")
        self.statuses.clear()
        return status

    def tick(self, nanoseconds):
        """Set the simulated time and wait until every node has it."""
        from builtin_interfaces.msg import Time
        from rosgraph_msgs.msg import Clock

        seconds, rest = divmod(nanoseconds, 10**9)
        self.clock.publish(Clock(clock=Time(sec=seconds, nanosec=rest)))
        self.until(
            lambda: all(node.get_clock().now().nanoseconds == nanoseconds for node in self.nodes),
            f"the clock to show {nanoseconds} ns",
        )

    def call(self, service_type, name, **request):
        """Call a service of a node under test."""
        client = self.probe.create_client(service_type, name)
        self.until(client.service_is_ready, f"service {name}")
        future = client.call_async(service_type.Request(**request))
        self.until(future.done, f"the answer of {name}")
        return future.result()

    def set(self, node, name, value):
        """Set a parameter as ``ros2 param set`` does; return the result."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        service = f"{node.get_fully_qualified_name()}/set_parameters"
        change = Parameter(name, value=value).to_parameter_msg()
        return self.call(SetParameters, service, parameters=[change]).results[0]


@contextlib.contextmanager
def sketching():
    """Let pictures be blank, where nobody looks at what they show: to render one takes seconds."""
    from matplotlib.figure import Figure

    render = Figure.savefig

    def blank(figure, *words, **options):
        render(Figure(figure.get_size_inches()), *words, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", blank)
        yield


@pytest.fixture
def sketched():
    with sketching():
        yield


@pytest.fixture
def strict_arithmetic():
    """Raise on every floating-point accident, so that nothing escapes unseen."""
    import numpy as np

    with np.errstate(all="raise"):
        yield


@pytest.fixture
def strict_but_for_zeros():
    """Raise on every floating-point accident except underflow, which is a correct zero."""
    import numpy as np

    with np.errstate(over="raise", divide="raise", invalid="raise"):
        yield


@pytest.fixture
def lab():
    lab = Lab()
    yield lab
    lab.end()


def write_scene(folder, name, **changes):
    """Write the reference scene with a table of 5^5 rows, and with other settings."""
    from scenes import changed, coarse

    from uuv_optical_array.forward.scene import save_scene

    path = folder / f"{name}.yaml"
    save_scene(changed(coarse("reference"), **changes), path, "Of a test.")
    return path


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory):
    """A scene whose table is small."""
    return str(write_scene(tmp_path_factory.mktemp("scene"), "small"))


@pytest.fixture(scope="session")
def scene(scene_file):
    from uuv_optical_array.forward.scene import load_scene

    return load_scene(scene_file)


@pytest.fixture(scope="session")
def table(scene):
    from uuv_optical_array.estimation.signature_table import build_table

    return build_table(scene)


@pytest.fixture
def page(scene):
    """A page of the live view, on a port of this machine."""
    from uuv_optical_array.view.page import Page

    page = Page(scene, "a test", port=18080)
    yield page
    page.close()


@pytest.fixture(scope="session")
def compiled_fit():
    """The fit compiled in this process, where Numba is installed, so that no node waits for it."""
    from uuv_optical_array.estimation import fit_compiler

    fit_compiler.fit_compiler().wait()


@pytest.fixture
def shower(lab, scene_file, scene, compiled_fit):
    """An estimator node that fits, and what sends it images."""
    from asker import Shower

    return Shower(lab, scene_file, scene, method="least_squares")


@pytest.fixture
def asker(lab, scene_file):
    """An estimator node that matches key parameters alone, and what sends it these."""
    from asker import Asker

    return Asker(lab, scene_file)


@pytest.fixture
def joiner(lab, scene_file, scene, compiled_fit):
    """An estimator node that holds its match to the image, and what sends it both."""
    from asker import Shower

    return Shower(lab, scene_file, scene)


@pytest.fixture(scope="module")
def images(scene):
    """Ten noisy images of poses between those of the table."""
    import numpy as np

    from uuv_optical_array.forward.model import ForwardModel

    rng = np.random.default_rng(8)
    poses = rng.uniform([-5.5, -0.2, -0.2, -0.1, -0.1], [-4.5, 0.2, 0.2, 0.1, 0.1], (10, 5))
    return ForwardModel(scene).expose(poses, rng)


@pytest.fixture(scope="module")
def signatures(scene, images):
    """Key parameters of the images."""
    from uuv_optical_array.estimation.signature.features import key_parameters

    return key_parameters(images, scene.full_scale_counts, scene.signature.peak)
