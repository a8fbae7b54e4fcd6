"""Inner functions that Numba compiles only into their callers, in half of the time.

Numba optimises and emits each function by itself and once more in each caller. An inner function
is called from compiled code alone, so its library here is only linked into that of its caller. And
a tenth of the time Numba compares options, and takes values apart to count what they do not hold.
This uses Numba's internals, so only in versions in which it was tried; others compile as usual.
"""

from typing import Any

import numba
from numba.core import codegen, compiler
from numba.core.runtime.context import NRTContext

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


def _collect(library: Any, needed: dict[Any, None]) -> None:
    for other in library._linking_libraries:
        if other not in needed:
            needed[other] = None
            if isinstance(other, _InnerLibrary):
                _collect(other, needed)


class _Flags(compiler.Flags):
    """Options of a function, which each operation in it compares with those of others."""

    def __hash__(self) -> int:
        return len(self._values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, compiler.Flags) and self._values == other._values


class _References(NRTContext):
    """Counts references to arrays; what holds none is not taken apart for that."""

    def get_meminfos(self, builder: Any, kind: Any, value: Any) -> list[Any]:
        models = self._context.data_model_manager
        if models[kind].has_nrt_meminfo():
            return [(kind, models[kind].get_nrt_meminfo(builder, value))]
        parts = models[kind].traverse(builder)
        held = [part for part in parts if models[part[0]].contains_nrt_meminfo()]
        return [at for each, get in held for at in self.get_meminfos(builder, each, get(value))]


class _InnerCompiler(compiler.Compiler):
    library: Any = _InnerLibrary

    def __init__(self, typing: Any, target: Any, library: Any, *arguments: Any) -> None:
        if library is None:
            library = self.library(target.codegen(), "linked")
            library.enable_object_caching()
        super().__init__(typing, target, library, *arguments)
        self.state.flags, own = _Flags(self.state.flags), self.state.targetctx
        own.nrt = _References(own, own.enable_nrt)


class _OuterCompiler(_InnerCompiler):
    library = _OuterLibrary


def options(inner: bool) -> dict[str, Any]:
    """Return the options of Numba's ``njit`` for inner functions, and for those that call them."""
    pipeline = _InnerCompiler if inner else _OuterCompiler
    return {"pipeline_class": pipeline} if numba.__version__.startswith(TRIED) else {}
