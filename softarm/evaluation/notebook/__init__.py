"""Python functions of `softarm` itself, whose results show themselves in Jupyter: `softarm.fly`, `softarm.diagnose`."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs(extra: str) -> Iterator[None]:
    """Explain a missing package of an extra, during a block or a decorated function.

    Raises:
        ModuleNotFoundError: A package is not installed; the text names it and the extra.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package == "softarm":
            raise  # a defect, no missing extra
        text = f"the package '{package}' is not installed; run pip install 'softarm[{extra}]'"
        raise ModuleNotFoundError(text, name=error.name) from None
