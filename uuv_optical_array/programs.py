"""What the operating system starts: ``uuv_array`` and the nodes, each imported when it is run.

Ctrl-C during an import ends the process at once: an exception there can pass for a missing module,
and otherwise prints the stack of the import. A node without ROS says what to install.

BLAS gets one thread, unless the user says otherwise: with matrices as small as those of an image
its threads mostly wait for each other, and for the processors of other nodes. Pictures look the
same whatever Matplotlib is told elsewhere: a notebook's shell hands on its backend, which draws
into the notebook, and a style of the user's may need what is not there.
"""

import os
import signal
import sys
from collections.abc import Callable
from importlib import import_module
from io import TextIOWrapper
from types import FrameType
from typing import Any

INTERRUPTED = 130  # exit code of a command after Ctrl-C
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1"}  # which BLAS reads when NumPy is imported
OURS = {"MPLBACKEND": "agg", "MATPLOTLIBRC": os.devnull}  # whatever the user's


def _program(
    module: str, code: int, line: bytes = b"", load: Callable[[str], Any] = import_module
) -> Callable[[], None]:
    def end(number: int, frame: FrameType | None) -> None:
        os.write(2, line)
        os._exit(code)

    def program() -> None:
        os.environ.update(ENVIRONMENT | os.environ | OURS)
        _complete_streams()
        usual = signal.getsignal(signal.SIGINT)
        if usual != signal.SIG_IGN:  # a shell's background ignores it
            signal.signal(signal.SIGINT, end)
        main = load(f"uuv_optical_array.{module}").main
        signal.signal(signal.SIGINT, usual)
        try:
            main()
        finally:
            # Ctrl-C reaches a launched node twice, from the terminal and from launch, and a handler
            # of ours would not outlive the interpreter, which takes its time to end.
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    return program


def _complete_streams() -> None:
    """Let standard streams that were closed take what is written, and take any file's name."""
    for name in ("stdin", "stdout", "stderr"):  # in the order of their numbers, which are free
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _node(name: str) -> Callable[[], None]:
    def load(module: str) -> Any:
        from uuv_optical_array.core.extras import NotInstalled, needs

        try:
            return needs("ros", module)
        except NotInstalled as error:
            sys.exit(f"{name}_node: {error}")

    # SIGINT is how a node is stopped.
    return _program(f"nodes.{name}_node", 0, load=load)


simulator_node = _node("simulator")
feature_node = _node("feature")
estimator_node = _node("estimator")
formation_node = _node("formation")
follower_node = _node("follower")
vehicles_node = _node("vehicles")
view_node = _node("view")
uuv_array = _program("commands", INTERRUPTED, b"interrupted\n")
