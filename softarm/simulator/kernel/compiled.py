"""Decorator that compiles the kernel; an edit of any file recompiles all, since functions are inlined across files."""

from pathlib import Path

from softarm.simulator.compiled import compiler

_HERE = Path(__file__).parent
SOURCES = (*sorted(_HERE.glob("*.py")), _HERE.parent / "simd.py", _HERE.parent / "compiled.py")
compiled = compiler(*SOURCES)
