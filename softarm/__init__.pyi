"""Types of the names that softarm imports on first use."""

from softarm.evaluation.notebook.diagnose import diagnose as diagnose
from softarm.evaluation.notebook.fly import fly as fly

__all__ = ["__version__", "diagnose", "fly"]
__version__: str
