"""The page on a simulation: the closed loop in real time, in a sea that sliders change."""

import time
from collections.abc import Callable

import numpy as np

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.effects.waters import EREN_KD_PER_M, PETZOLD_PER_M
from uuv_optical_array.view.closed_loop import Conditions, ViewedLoop
from uuv_optical_array.view.page import Page, Slider

STEP_S = 0.1


def sliders(conditions: Conditions, dims: str = "attenuation") -> list[Slider]:
    """Return the sliders of conditions, in the order in which `chosen` takes their values.

    What dims the light with the range is called `dims`.
    """
    x, y, z = conditions.station_m
    along, aside, _ = conditions.current_m_per_s
    powers = conditions.lamp_power
    k_per_m, plume = conditions.k_per_m, conditions.plume_depth
    if dims == "absorption":
        (clear, _), (coastal, _) = PETZOLD_PER_M["petzold_clear"], PETZOLD_PER_M["petzold_coastal"]
    else:
        clear, coastal = EREN_KD_PER_M["eren2016_clear"], EREN_KD_PER_M["eren2016_coastal"]
    water = f"Of the water: {clear:g} clear ocean, {coastal:g} coastal"
    names = [f"power of lamps[{i}]" for i in range(len(powers))] if powers[1:] else ["lamp power"]
    lamps = zip(names, powers, strict=True)
    cloud = "Optical depth in the middle of a cloud of sediment; 0 is none"
    return [
        Slider(f"{dims} (1/m)", water, 0.0, max(0.5, k_per_m), 0.005, k_per_m),
        *(Slider(n, "Relative to the scene's; 0 is off", 0.0, 2.0, 0.05, p) for n, p in lamps),
        Slider("plume", cloud, 0.0, max(3.0, plume), 0.1, plume),
        Slider("current x (m/s)", "Along the leader's first heading", -0.5, 0.5, 0.05, along),
        Slider("current y (m/s)", "To port of the leader's first heading", -0.5, 0.5, 0.05, aside),
        Slider("astern (m)", "Station behind the lamp", 2.0, 10.0, 0.1, -x),
        Slider("to port (m)", "Station beside the beam's axis", -1.0, 1.0, 0.05, y),
        Slider("up (m)", "Station above the beam's axis", -1.0, 1.0, 0.05, z),
    ]


def chosen(values: list[float]) -> Conditions:
    """Return the conditions of the sliders' values."""
    k_per_m, *powers, plume, along, aside, astern, port, up = map(float, values)
    return Conditions(k_per_m, tuple(powers), plume, (along, aside, 0.0), (-astern, port, up))


def simulate(
    page: Page, estimator: Estimator, seed: int | None, goes_on: Callable[[float], bool]
) -> None:
    """Show the closed loop on a page while it goes on; without a seed each run has other noise."""
    loop = ViewedLoop(estimator, np.random.default_rng(seed))
    conditions, restart = loop.conditions, False

    # The page calls these from its own thread; they act between two steps.
    def change(values: list[float]) -> None:
        nonlocal conditions
        conditions = chosen(values)

    def start_again() -> None:
        nonlocal restart
        restart = True

    dims = "absorption" if "sea" in estimator.scene.effects else "attenuation"
    page.add_sliders("sea and station", sliders(conditions, dims), change)
    page.add_button("start again", start_again)
    due = time.monotonic()
    while goes_on(loop.t_s):
        if restart:
            loop = ViewedLoop(estimator, np.random.default_rng(seed), conditions)
            restart = False
        if conditions is not loop.conditions:
            loop.change(conditions)
        page.show(loop.step(STEP_S))
        due += STEP_S
        late_s = time.monotonic() - due
        if late_s > 0:
            due += late_s  # on a slow machine it runs in slow motion
        else:
            time.sleep(-late_s)
