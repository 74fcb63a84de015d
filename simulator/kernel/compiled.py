"""How the kernel is compiled: functions of one file are inlined into others, so an edit of any compiles all anew."""

from pathlib import Path

from softarm.simulator.compiled import compiler

_HERE = Path(__file__).parent
SOURCES = (*sorted(_HERE.glob("*.py")), _HERE.parent / "simd.py", _HERE.parent / "compiled.py")
compiled = compiler(*SOURCES)
