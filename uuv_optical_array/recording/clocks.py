"""A recording whose images were taken earlier or later than their stamps say."""

import dataclasses

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.recording.images import Recording

STEP_S = 0.05  # on either side of a stamp, for the rate of a pose


def shifted(recording: Recording, offset_s: float, posed: bool = True) -> Recording:
    """Return the images with their poses at their stamps and an offset, s.

    Commands are by the clock of the poses, and move with it.

    - posed: leave out, and count, images that lose their pose by it; else these are nan.
    - ValueError: where all lose it, or the poses are those of a table.
    """
    if recording.poses_at is None:
        raise ValueError("time_offset_s: poses from a table of places have no clock; leave it out")
    poses, rolls = recording.poses_at(_later(recording, offset_s))
    known = ~np.isnan(np.column_stack([recording.poses, recording.rolls]))
    lost = (np.isnan(np.column_stack([poses, rolls])) & known).any(axis=1)
    if lost[known.any(axis=1)].all():
        raise ValueError(
            f"time_offset_s: no image has a known pose {offset_s:g} s from its stamp; check both "
            "clocks"
        )
    back_ns = _in_ns(offset_s)
    commands = [(stamp - back_ns, linear, turn) for stamp, linear, turn in recording.commands]
    moved = dataclasses.replace(
        recording, poses=poses, rolls=rolls, commands=commands, offset_s=offset_s
    )
    if not posed:
        return moved
    return moved.only(~lost, "images without a pose at the offset of the clocks")


def rates_of(recording: Recording) -> Recording:
    """Return the recording with the `rates` of its poses and rolls; 0 where they are not known."""
    assert recording.poses_at is not None
    ends = []
    for sign in (-1, 1):
        poses, rolls = recording.poses_at(_later(recording, recording.offset_s + sign * STEP_S))
        ends.append(np.column_stack([poses, rolls]))
    middle = np.column_stack([recording.poses, recording.rolls])
    # At the ends of a record one side alone is known.
    before, after = (np.where(np.isnan(end), middle, end) for end in ends)
    sides = (~np.isnan(ends[0])).astype(float) + ~np.isnan(ends[1])
    change = after - before
    change[:, 3:] = (change[:, 3:] + np.pi) % (2 * np.pi) - np.pi
    rates: Array = np.nan_to_num(change / (STEP_S * np.maximum(sides, 1)))
    return dataclasses.replace(recording, rates=rates)


def _later(recording: Recording, offset_s: float) -> np.typing.NDArray[np.int64]:
    return recording.stamps_ns + np.int64(_in_ns(offset_s))


def _in_ns(offset_s: float) -> int:
    return round(offset_s * 1e9)
