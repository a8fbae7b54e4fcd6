"""Nodes in processes of their own, which the tests reach over DDS alone."""

import contextlib
import signal
import subprocess
import sys

from conftest import PATIENCE_S


@contextlib.contextmanager
def node_processes(log, nodes, **parameters):
    """Run nodes with parameters, such as ``**{"estimator_node:method": "sam"}``.

    At the end each must stop by Ctrl-C, without an error; the file `log` has what they wrote.
    """
    arguments = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    with log.open("w") as file:
        processes = [
            subprocess.Popen(
                [
                    sys.executable,
                    "-c",
                    f"from uuv_optical_array.nodes.{node} import main; main()",
                    "--ros-args",
                    *arguments,
                ],
                stderr=file,
                stdout=file,
            )
            for node in nodes
        ]
        try:
            yield
        finally:
            for process in processes:
                process.send_signal(signal.SIGINT)
            codes = [process.wait(timeout=PATIENCE_S) for process in processes]
    text = log.read_text()
    print(text)
    assert codes == [0] * len(nodes), text
    assert "Traceback" not in text
