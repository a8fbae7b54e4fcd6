"""Inner functions that Numba compiles only into their callers.

Numba optimises and emits each function by itself and once more in each caller, and so compiles the
fit for three times as long (benchmarks/kernel.py). An inner function is called from compiled code
alone, so its library here is only linked into that of its caller. This uses Numba's internals, so
only in versions in which it was tried; others compile as usual.
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


class _InnerLibrary(codegen.JITCodeLibrary):
    """The code of a function, neither optimised nor emitted nor linked with what it calls."""

    codegen = _WithoutEnvironment()

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"  # as Numba links what may come twice
        self._finalized = True


class _OuterLibrary(codegen.JITCodeLibrary):
    """The code of a function with all that it calls, which is linked once."""

    def finalize(self) -> None:
        needed: dict[Any, None] = {}
        _collect(self, needed)
        self._linking_libraries = list(needed)
        super().finalize()

    def _optimize_final_module(self) -> None:
        # A function that nobody else may call loses the arguments that it does not use: without
        # this a frame takes 1.06 times as long.
        for library in self._linking_libraries:
            if isinstance(library, _InnerLibrary):
                for function in library.get_defined_functions():
                    self._final_module.get_function(function.name).linkage = "internal"
        # Numba has two passes, as it looks for counted references in between: laws count none.
        manager, builder = self._codegen._module_pass_manager()
        manager.run(self._final_module, builder)


def _collect(library: Any, needed: dict[Any, None]) -> None:
    for other in library._linking_libraries:
        if other not in needed:
            needed[other] = None
            if isinstance(other, _InnerLibrary):
                _collect(other, needed)


class _InnerCompiler(compiler.Compiler):
    library: Any = _InnerLibrary

    def __init__(self, typing: Any, target: Any, library: Any, *arguments: Any) -> None:
        if library is None:
            library = self.library(target.codegen(), "linked")
            library.enable_object_caching()
        super().__init__(typing, target, library, *arguments)


class _OuterCompiler(_InnerCompiler):
    library = _OuterLibrary


def options(inner: bool) -> dict[str, Any]:
    """Return the options of Numba's ``njit`` for inner functions, and for those that call them."""
    pipeline = _InnerCompiler if inner else _OuterCompiler
    return {"pipeline_class": pipeline} if numba.__version__.startswith(TRIED) else {}
