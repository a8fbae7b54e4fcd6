"""``uuv_array`` as the tests run it, in this process or in one of its own, and its pictures."""

import contextlib
import io
import json
import os
import re
import signal
import struct
import subprocess
import sys

import pytest
from conftest import PATIENCE_S

from uuv_optical_array.commands import main

PROGRAM = [sys.executable, "-c", "from uuv_optical_array.commands import main; main()"]
# Before the code of a process that draws what nobody looks at, as `sketching` is in this one.
SKETCHING = """
from matplotlib.figure import Figure
render = Figure.savefig
Figure.savefig = lambda self, *words, **options: render(
    Figure(self.get_size_inches()), *words, **options
)
"""


def run(*words, code=0):
    """Run ``uuv_array`` in this process and expect an exit code; return the line of an error."""
    with contextlib.redirect_stderr(io.StringIO()) as told, pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    error = told.getvalue()
    sys.stderr.write(error)
    assert (end.value.code or 0) == code, error
    assert "Traceback" not in error, error
    return error.splitlines()[-1] if code in (1, 2) and error else ""


def text_of(command, *words, code=0):
    """Run a command, as `run` does; return what it prints."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        command(*words, code=code)
    return printed.getvalue()


def json_of(command, *words, code=0):
    """Run a command, as `run` does, with ``--json``; return the object that it prints."""
    return json.loads(text_of(command, *words, "--json", code=code))


def python(code, *words, **options):
    """Run code in a process of its own; return the process, ended, with what it wrote."""
    program = [sys.executable, "-c", code, *map(str, words)]
    return subprocess.run(
        program, capture_output=True, text=True, timeout=PATIENCE_S, check=False, **options
    )


@contextlib.contextmanager
def begun(program, **options):
    """Start a process, of which nothing is left where the test goes on without its end."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([*map(str, program)], **{**pipes, **options})
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def ended(process, code=0):
    """Wait for the end of a process with an exit code and no traceback; return what it wrote."""
    out, error = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == code, (out, error)
    assert "Traceback" not in error, error
    return out, error


def interrupted(program, shown, **options):
    """Press Ctrl-C once a process shows a pattern on standard error.

    Returns its exit code, and what it wrote to standard output and error, as bytes.
    """
    with begun(program, text=False, **options) as process:
        seen = b""
        while not re.search(shown, seen):
            more = os.read(process.stderr.fileno(), 4096)
            assert more, seen
            seen += more
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=PATIENCE_S)
    return process.returncode, out, error


def assert_picture(path, least_width=800, least_height=500):
    """Expect a whole PNG of a size that can be read."""
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert data[12:16] == b"IHDR"
    width, height = struct.unpack(">II", data[16:24])
    assert width >= least_width
    assert height >= least_height
    assert data[-8:-4] == b"IEND"
