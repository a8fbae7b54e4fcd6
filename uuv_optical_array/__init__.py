"""One underwater vehicle follows another by light: the public names; see ``docs/design.md``.

A name's module is imported when it is first asked for.
"""

import importlib
from typing import Any

_HOME = {
    "load_scene": "forward.scene",
    "Scene": "forward.scene",
    "ForwardModel": "forward.model",
    "key_parameters": "estimation.signature.features",
    "spectral_angle": "estimation.signature.spectral_angle",
    "build_table": "estimation.signature_table",
    "load_table": "estimation.large_table",
    "Estimator": "estimation.estimator",
    "NoPose": "core.errors",
    "Pipeline": "estimation.pipeline",
    "cramer_rao_bound": "estimation.information.cramer_rao",
    "array_image": "plots.style",
}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    """Import a public name."""
    if name == "__version__":
        from importlib import metadata

        try:
            return metadata.version(__name__)
        except metadata.PackageNotFoundError:
            return "unknown: not installed"
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
