"""The pages of what the closed loops and seas of the studies differ in."""

import re
from collections.abc import Mapping, Sequence

from uuv_optical_array.studies.closed_loops.kinds import KINDS as TROUBLES
from uuv_optical_array.studies.mismatches.kinds import KINDS

# What differs between the texts of alike kinds of mismatch.
SIZE = re.compile(r"(\d+(?:\.\d+)?|less|more)")


def mismatches() -> list[str]:
    """Return the page of the kinds of mismatch, by what to do about them."""
    parts = [
        "# Kinds of mismatch",
        "The kinds of `uuv_array study robustness` ([results](../results/robustness.md)): what "
        "differs from the scene, in brackets by how many standard deviations of the prior "
        "`known: calibrated` (of scattering as a logarithm), and, in italics, what to do about it.",
    ]
    for cure in dict.fromkeys(kind.cure for kind in KINDS):
        named = {
            f"`{kind.name}`"
            + ("" if kind.times_prior is None else f" [{kind.times_prior:.2g}]"): kind.what
            for kind in KINDS
            if kind.cure == cure
        }
        parts += [folded(named), f"*{cure}*"]
    return parts


def troubles() -> list[str]:
    """Return the page of the kinds of trouble, by group."""
    parts = [
        "# Kinds of trouble",
        "The troubles of a follower in `uuv_array study envelope` "
        "([results](../results/envelope.md)). The scene of the estimator names none of them "
        "but the clouds of `night_plume`. Unless a kind says otherwise:",
        "- The leader sets off once all followers are locked, and moves at 0.5 m/s: straight on in "
        "the groups Darkness and Leader and in a chain, else on the demonstration's path.\n"
        "- Currents and other speeds begin as the leader sets off, manoeuvres that a kind names "
        "15 s later.\n"
        "- Light, water and IMU change 15 s after the start of the run; the leader's lamp goes out "
        "beside another one after 20 s.\n"
        "- Wrong detectors, the clouds of `night_plume` and equal lamps aside are there from the "
        "start, except in `other_instead`.",
        "Each kind with `at once` has two more: `..._slow` changes within 30 s, `..._back` at once "
        "and is as before after 30 s.",
    ]
    once = {kind.name for kind in TROUBLES if kind.what.endswith(", at once.")}
    more = {f"{name}{way}" for name in once for way in ("_slow", "_back")}
    for group in dict.fromkeys(kind.group for kind in TROUBLES):
        named = {
            f"`{kind.name}`": kind.what
            for kind in TROUBLES
            if kind.group == group and kind.name not in more
        }
        parts += [f"## {group.capitalize()}", folded(named)]
    return parts


def folded(named: Mapping[str, str]) -> str:
    """Return a list of names and what they mean, where what differs by sizes alone is one."""
    alike: dict[str, list[str]] = {}
    for name, what in named.items():
        alike.setdefault(SIZE.sub("", what), []).append(name)
    lines = []
    for names in alike.values():
        words = zip(*(SIZE.split(named[name]) for name in names), strict=True)
        what = "".join(one_of(list(dict.fromkeys(word))) for word in words)
        lines.append(f"- {', '.join(names)}: {what}")
    return "\n".join(lines)


def one_of(words: Sequence[str]) -> str:
    """Return words as a list in a sentence."""
    return " or ".join(part for part in (", ".join(words[:-1]), words[-1]) if part)
