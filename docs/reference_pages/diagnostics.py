"""The page of the texts and values that nodes show on ``/diagnostics``."""

from collections import Counter
from collections.abc import Mapping

from causes import CAUSES

from uuv_optical_array.nodes.shared import reasons

# Values on ``/diagnostics``: names as Markdown, nodes that show them, and what they mean.
VALUES = (
    ("`answered`, `refused`, `refused: ...`", "all", "messages, refused ones also by kind"),
    ("`taken`", "formation", "poses that it took; `answered` counts commands"),
    (
        "`passed_over`",
        "feature in `follower_node`, else estimator with `use_image`",
        "images, or their key parameters, left out for newer ones",
    ),
    (
        "`Events in window`, `Events since startup`, `Duration of window (s)`, "
        "`Actual frequency (Hz)`",
        "all",
        "answers and their rate",
    ),
    (
        "`Earliest timestamp delay:`, `Latest timestamp delay:`",
        "all but vehicles",
        "age of stamps as they were answered or taken, s",
    ),
    (
        "`Timestamp jitter (s)`",
        "all but vehicles",
        "standard deviation of the time between stamps",
    ),
    ("`cure: ...`", "all", "what to do, by the kind of the text"),
    ("`peak_counts`", "simulator, feature, view", "brightest detector, counts"),
    (
        "`light_level`, `saturated_share`",
        "feature",
        "largest reading over full scale (near 0: dim), and share of readings at full scale",
    ),
    ("`range_m`", "simulator, formation", "distance behind the lamp, m"),
    ("`sea`", "simulator", "differences of the simulated sea from the scene"),
    (
        "`method`, `fit`",
        "estimator",
        "the method; the fit of `least_squares`: `compiled`, or `as it stands`, which is slower",
    ),
    (
        "`angle_rad`, `runner_up_angle_rad`",
        "estimator",
        "spectral angle to the nearest signature or, by `least_squares`, start of the fit, and to "
        "the runner-up",
    ),
    (
        "`misfit`, `runner_up_misfit`",
        "estimator",
        "probability of larger residuals in this scene; near 0 the light differs from it",
    ),
    ("`unobservable`", "estimator", "degrees of freedom that the image hardly shows"),
    (
        "`std_x`, `std_y`, `std_z`, `std_pitch`, `std_yaw`",
        "estimator",
        "standard deviation of the pose, m and rad",
    ),
    (
        "`table_margin`",
        "estimator",
        "place in the `table`, and its axis: 1 in the middle, 0 at the edge, < 0 beyond",
    ),
    (
        "`own_motion`",
        "estimator",
        "whether `cmd_vel` is used: `told`: it is; `not told`: none came for `command_timeout_s`, "
        "its clock differs, or `use_commands` is false; `contradicted`: the images disagree, and "
        "it is not used. If `contradicted` lasts, check that the follower obeys `cmd_vel`, in m/s "
        "and rad/s along its own axes, or set `use_commands` to false",
    ),
    ("`range`", "estimator", "difference of the last range from the track, and whether it is used"),
    (
        "`learnt_...`",
        "estimator",
        "difference of a constant from the scene's, by the track, and its standard deviation; of "
        "power, scattering and radius as logarithms",
    ),
    ("`scene_...`", "estimator", "value to write into the scene, where the sea differs"),
)


def diagnostics() -> list[str]:
    """Return the page of the texts that nodes show."""
    parts = [
        "# Diagnostics",
        "The warnings and errors on `/diagnostics` by the beginning of their texts, with cause "
        "and, in italics, cure. Causes after a colon are examples. A topic and a comma may stand "
        "before a text. An error that names a missing module says how to install it. "
        "[Operations](../how_to/operations.md) says where to begin.",
    ]
    for heading, kinds in (
        ("Refused messages", reasons.REFUSALS),
        ("Warnings that last", reasons.WARNINGS),
        ("Errors", reasons.ERRORS),
    ):
        parts += [f"## {heading}", *reason_lists(kinds)]
    return [
        *parts,
        "## Values",
        "The nodes are in brackets. Counts are since the start, but for `Events in window`, of "
        "about 5 s at most. What is shown of an image or a pose is of the newest of the last "
        "second.",
        "\n".join(f"- {names} ({of}): {meaning}" for names, of, meaning in VALUES),
    ]


def reason_lists(cures: Mapping[str, str]) -> list[str]:
    """Return a list of causes and cures, and one for each cure that many kinds share."""
    common = [cure for cure, count in Counter(cures.values()).items() if count > 1]
    lines = [
        f"- `{kind}`: {CAUSES[kind]} *{cure}*" for kind, cure in cures.items() if cure not in common
    ]
    parts = ["\n".join(lines)]
    for cure in common:
        causes = [f"- `{kind}`: {CAUSES[kind]}" for kind in cures if cures[kind] == cure]
        parts += [f"*{cure}*", "\n".join(causes)]
    return parts
