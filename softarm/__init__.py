"""Control, simulation and training for a dynamic soft robot arm on a rail."""

import os
from pathlib import Path

__version__ = "0.3.0"


def _use_the_same_blas_kernels_everywhere() -> None:
    """Select OpenBLAS's AVX2 kernels on CPUs with AVX-512, before numpy is imported.

    Both round differently, and a search of the diagnosis over a rugged loss can end elsewhere. $OPENBLAS_CORETYPE wins.
    """
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8", errors="replace") as file:
            has_avx512 = " avx512f " in file.read(8192)
    except OSError:
        return
    if has_avx512:
        os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")


_use_the_same_blas_kernels_everywhere()
