"""The names of `softarm` itself: complete, typed, and imported on first use."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import softarm

PACKAGE = Path(softarm.__file__).parent


def test_an_import_of_softarm_loads_no_other_module_of_it_and_no_numpy():
    code = "import sys; before = set(sys.modules); import softarm; print(*sorted(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-S", "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True)
    loaded = set(done.stdout.split())
    assert "softarm" in loaded
    assert not {name for name in loaded if name.startswith(("softarm.", "numpy", "importlib.metadata"))}


def test_the_stub_has_every_public_name():
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    named = {alias.asname for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert named | {"__version__"} == set(softarm.__all__)
    assert set(softarm.__all__) <= set(dir(softarm))
    for name in named:
        assert callable(getattr(softarm, name))


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'softarm' has no attribute 'flie'"):
        _ = softarm.flie
