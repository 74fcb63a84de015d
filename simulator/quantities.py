"""A range with a unit, and the help it can give to somebody who wrote a number of another unit."""

import math
import re
from dataclasses import dataclass

from softarm.schemas.model import KPA_PER_PSI

DEGREE_RAD = math.pi / 180

# What people write by mistake, and what it is worth in the unit that is meant. "-" is a pure number.
MISTAKEN_UNITS: dict[str, dict[str, float]] = {
    "-": {"%": 1e-2, "percent": 1e-2},
    "s": {"ms": 1e-3, "us": 1e-6},
    "m": {"mm": 1e-3, "cm": 1e-2},
    "m/s": {"mm/s": 1e-3, "cm/s": 1e-2},
    "m/s^2": {"mm/s^2": 1e-3, "cm/s^2": 1e-2},
    "rad": {"degrees": DEGREE_RAD, "deg": DEGREE_RAD, "mrad": 1e-3},
    "1/rad^2": {"1/degree^2": DEGREE_RAD**-2},
    "kPa": {"psi": KPA_PER_PSI, "Pa": 1e-3, "mbar": 0.1, "bar": 100.0},
    "kPa/s": {"psi/s": KPA_PER_PSI, "Pa/s": 1e-3, "bar/s": 100.0},
    "kg": {"g": 1e-3},
    "kg m^2": {"kg cm^2": 1e-4, "kg mm^2": 1e-6, "g cm^2": 1e-7, "g mm^2": 1e-9},
    "N": {"mN": 1e-3},
    "N m": {"mN m": 1e-3, "N mm": 1e-3},
    "N/m": {"N/mm": 1e3, "kN/m": 1e3},
    "N s/m": {},
    "N s^2/m^2": {},
    "N m/rad": {"N mm/rad": 1e-3, "N m/degree": 1 / DEGREE_RAD},
    "N m s/rad": {"N mm s/rad": 1e-3, "N m s/degree": 1 / DEGREE_RAD},
    "N m/kPa": {"N m/psi": 1 / KPA_PER_PSI, "N m/bar": 1e-2, "N mm/kPa": 1e-3},
}


@dataclass(frozen=True)
class Range:
    """low .. high in `unit`, and one number beside it that is allowed too (inf: no such effect)."""

    unit: str
    low: float
    high: float
    also: float | None = None

    def admits(self, number: float) -> bool:
        """Whether a number is allowed; NaN never is."""
        return self.low <= number <= self.high or number == self.also

    def __str__(self) -> str:
        unit = "" if self.unit == "-" else f" {self.unit}"
        outside = self.also is not None and not self.low <= self.also <= self.high
        return f"{self.low:g} to {self.high:g}{unit}" + (f", or {self.also:g} for none" if outside else "")

    def complaint(self, number: float) -> str:
        """Say of a number that is not allowed what is, and which unit it may have been meant in."""
        text = f"is {number:g}; allowed {self}"
        for unit, factor in MISTAKEN_UNITS[self.unit].items():
            if math.isfinite(number) and self.admits(number * factor):
                return f"{text}; if you meant {number:g} {unit}, write {number * factor:.4g}"
        return text

    def complaint_of_text(self, text: str) -> str:
        """Say of a text in place of a number (`3 psi`) what to write."""
        bare = "a pure number" if self.unit == "-" else f"a bare number in {self.unit}"
        match = re.fullmatch(r"\s*([-+]?[0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]+)?)\s*(.*?)\s*", text)
        factors = {"": 1.0, self.unit: 1.0} | MISTAKEN_UNITS[self.unit]
        if match is None or match[2] not in factors:
            return f"is {text!r}; write {bare}, {self}"
        return f"is {text!r}; write {bare}: {float(match[1]) * factors[match[2]]:.6g}"
