"""A slow course before the lamp, its images as messages, and the nodes that answer them."""

import gc
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from uuv_optical_array import ForwardModel, load_scene
from uuv_optical_array.core.storage import yaml_text
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.nodes.follower_node import follower
from uuv_optical_array.nodes.shared.messages import image_to_message
from uuv_optical_array.nodes.shared.node import fastest_executor, spin, start
from uuv_optical_array.programs import ENVIRONMENT

TURN_S = 60.0  # time in which the course is back where it began
READY = "ready"


def as_programs() -> None:
    """Go on in the environment of the package's programs: start this script anew where it lacks."""
    environment = ENVIRONMENT | os.environ
    if environment != dict(os.environ):
        os.execve(sys.executable, [sys.executable, *sys.argv], environment)


def write_scene(folder: Path, side: int) -> tuple[Scene, Path]:
    """Write `follow` with another array and a table that is built in a second."""
    values = load_scene("follow").settings()
    values["array"]["detectors_per_side"] = side
    values["table"] = {key: [*span[:2], 9] for key, span in values["table"].items()}
    path = folder / f"follow{side}.yaml"
    path.write_text(yaml_text.text_of(values), encoding="utf-8")
    return load_scene(str(path)), path


def pose_at(time_s: np.ndarray | float) -> np.ndarray:
    """Return the pose on the course, m and rad, shape ``(..., 5)``: as slow as vehicles are."""
    turn = 2 * np.pi * np.asarray(time_s) / TURN_S
    ways = [-6 + np.sin(turn), 0.3 * np.cos(turn), 0.2 * np.sin(2 * turn)]
    return np.stack([*ways, 0.03 * np.sin(turn), 0.05 * np.cos(turn)], axis=-1)


def stamp_of(nanoseconds: int) -> Time:
    """Return a stamp."""
    seconds, rest = divmod(nanoseconds, 10**9)
    return Time(sec=seconds, nanosec=rest)


def exposures(scene: Scene, stamps_ns: list[int], rng: np.random.Generator) -> list[Image]:
    """Return the course's images at stamps, as messages."""
    images = ForwardModel(scene).expose(pose_at(np.array(stamps_ns) * 1e-9), rng)
    return [
        image_to_message(image, Header(stamp=stamp_of(stamp), frame_id="array"))
        for stamp, image in zip(stamps_ns, images, strict=True)
    ]


def serve(arguments: list[str], others: tuple = ()) -> None:
    """Run the follower's nodes, and say when the fit is compiled; until a signal."""
    start(["--ros-args", *arguments])
    executor, nodes = fastest_executor(), follower()
    for node in (*nodes, *(make() for make in others)):
        executor.add_node(node)
    estimator = nodes[1]
    estimator.pipeline.estimator.wait()
    gc.freeze()  # as the programs do
    print(READY, flush=True)
    spin(executor)
    rclpy.try_shutdown()


def served(script: str, arguments: list[str]) -> "subprocess.Popen[str]":
    """Start a script's ``--serve`` in a process of its own, and wait until it is ready."""
    command = [sys.executable, script, "--serve", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    if process.stdout.readline().strip() != READY:
        raise RuntimeError(f"{' '.join(command)} ended with {process.wait()}")
    return process
