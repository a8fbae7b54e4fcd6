"""A measurement of the trade-off made by hand."""

from uuv_optical_array.studies.tradeoff import METHODS, PUBLISHED, Measurement

ALL_METHODS = (*PUBLISHED, *METHODS)


def row(method="sam", side=5, rows=1024, position=0.5, angle=5.0, ms=1.0, lost=0.0, **others):
    """Return a line of the CSV; `others` are its columns by name."""
    values = {
        **{"method": method, "shape": "curved", "detectors_per_side": side},
        **{"steps": 4, "table_rows": rows, "without_pose": lost},
        **{"position_m": position, "angle_deg": angle},
        **{"bound_position_m": 0.1, "bound_angle_deg": 1.0},
        **{"floor_position_m": 0.1, "floor_angle_deg": 1.0},
        **{"median_ms": ms, "p99_ms": 2 * ms, "model_ms": 0.5, "models": 2 * ms},
        **{"build_s": 0.1, "load_average": 1.0},
    }
    return Measurement(**{**values, **others})
