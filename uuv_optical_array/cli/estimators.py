"""What an estimator needs first: its table and its compiled fit, made with progress."""

import sys
from functools import partial

from uuv_optical_array.cli import progress
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.fit_compiler import is_compiled
from uuv_optical_array.estimation.table.disk import cached_table
from uuv_optical_array.estimation.table.signature_table import SignatureTable
from uuv_optical_array.forward.scene import Scene

COMPILING = "compiling the fit, once on a machine: a minute or two"


def table_of(scene: Scene) -> SignatureTable:
    """Return the table for an `Estimator`, which says on standard error what takes long first."""
    table = cached_table(scene, partial(progress.over, unit="block", what="signature table"))
    if compilation.installed() and not is_compiled(scene):
        print(COMPILING, file=sys.stderr, flush=True)
    return table
