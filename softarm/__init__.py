"""Control, simulation and training for a dynamic soft robot arm on a rail."""

import os
from pathlib import Path

__version__ = "0.3.0"
__all__ = ["__version__", "diagnose", "fly"]

# Function -> its module, imported on first use; __init__.pyi has the types.
_FUNCTIONS = {"fly": "softarm.evaluation.notebook.fly", "diagnose": "softarm.evaluation.notebook.diagnose"}


def __getattr__(name: str) -> object:
    if name not in _FUNCTIONS:
        raise AttributeError(f"module 'softarm' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_FUNCTIONS[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


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
