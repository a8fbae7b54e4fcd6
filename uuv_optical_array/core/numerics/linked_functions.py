"""Inner functions that Numba compiles only into their callers, in half of the time.

Numba optimises and emits each function by itself and, as its callers contain it, once more in each
of them. An inner function is called from compiled code alone, so its library here is only linked
into that of its caller. This uses what Numba keeps to itself, and therefore only in versions in
which it was tried; in others inner functions are compiled as Numba does it.

Importing this module imports Numba.
"""

from typing import Any

import numba
from numba.core import codegen, compiler

TRIED = ("0.68.",)  # versions, by their beginning


class _WithoutEnvironment:
    """A code generator for functions without an address, whose environment nobody can set."""

    @staticmethod
    def set_env(name: str, environment: Any) -> None:
        pass


class _LinkedLibrary(codegen.JITCodeLibrary):
    """The code of a function, neither optimised nor emitted."""

    codegen = _WithoutEnvironment()

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0


class _LinkedCompiler(compiler.Compiler):
    def __init__(self, typing: Any, target: Any, library: Any, *arguments: Any) -> None:
        library = library or _LinkedLibrary(target.codegen(), "linked")
        super().__init__(typing, target, library, *arguments)


def options() -> dict[str, Any]:
    """Return the options of Numba's ``njit`` for inner functions."""
    return {"pipeline_class": _LinkedCompiler} if numba.__version__.startswith(TRIED) else {}
