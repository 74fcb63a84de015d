"""Quantities with unit and bounds, and hints for values that are not allowed."""

import contextlib
import math
import re
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import TypeGuard

from softarm.common.words import did_you_mean

# Unit of a pure number.
PURE = "-"
KPA_PER_PSI = 6.894757
DEGREE_RAD = math.pi / 180

# Standard unit -> other units and their value in it, to convert columns and to suggest the intended unit.
UNITS: dict[str, dict[str, float]] = {
    PURE: {"1": 1.0, "%": 1e-2, "percent": 1e-2},
    "s": {"ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "m": {"mm": 1e-3, "cm": 1e-2, "millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "um": 1e-6, "in": 0.0254},
    "m/s": {"mm/s": 1e-3, "cm/s": 1e-2},
    "m/s^2": {"mm/s^2": 1e-3, "cm/s^2": 1e-2},
    "rad": {"degrees": DEGREE_RAD, "deg": DEGREE_RAD, "mrad": 1e-3, "rev": 2 * math.pi},
    "rad/s": {"deg/s": DEGREE_RAD, "rpm": math.pi / 30},
    "1/rad^2": {"1/degree^2": DEGREE_RAD**-2},
    "kPa": {"psi": KPA_PER_PSI, "Pa": 1e-3, "mbar": 0.1, "bar": 100.0, "hPa": 0.1, "MPa": 1e3},
    "kPa/s": {"psi/s": KPA_PER_PSI, "Pa/s": 1e-3, "mbar/s": 0.1, "bar/s": 100.0},
    "kg": {"g": 1e-3},
    "kg m^2": {"kg cm^2": 1e-4, "kg mm^2": 1e-6, "g cm^2": 1e-7, "g mm^2": 1e-9},
    "N": {"mN": 1e-3, "kN": 1e3},
    "N m": {"mN m": 1e-3, "N mm": 1e-3, "N cm": 1e-2, "kN m": 1e3},
    "N/m": {"N/mm": 1e3, "kN/m": 1e3},
    "N s/m": {},
    "N s^2/m^2": {},
    "N m/rad": {"N mm/rad": 1e-3, "N m/degree": 1 / DEGREE_RAD},
    "N m s/rad": {"N mm s/rad": 1e-3, "N m s/degree": 1 / DEGREE_RAD},
    "N m/kPa": {"N m/psi": 1 / KPA_PER_PSI, "N m/bar": 1e-2, "N mm/kPa": 1e-3},
    "V": {"mV": 1e-3},
    "A": {"mA": 1e-3},
    "counts": {},  # of an encoder or converter with unknown scale
    "Hz": {},
    "1/s": {"1/min": 1 / 60},
    "1/m": {},
    "kg/m^3": {},
    "MB": {"GB": 1e3},
    "days": {"h": 1 / 24},
}
# Other spellings of the units.
_SIGNS = str.maketrans(
    {
        "\N{DEGREE SIGN}": "deg",
        "\N{MICRO SIGN}": "u",
        "\N{GREEK SMALL LETTER MU}": "u",
        "\N{SUPERSCRIPT TWO}": "^2",
        "\N{MIDDLE DOT}": " ",
    }
)
# Units of sensors.
_COLUMNS = (PURE, "s", "m", "rad", "rad/s", "kPa", "N", "N m", "V", "A", "counts", "kg", "Hz")
_PRODUCTS = {"Nm": "N m", "N*m": "N m", "mNm": "mN m", "mN*m": "mN m", "Ncm": "N cm", "Nmm": "N mm", "kNm": "kN m"}
# A larger number is a typing error, not another unit.
_HUGE = 1e15
_NUMBER = re.compile(r"\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*(.*?)\s*")


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Allowed range of a number, low .. high in `unit`, and one allowed number outside of it (inf: no effect)."""

    name: str = ""
    unit: str = PURE
    low: float = -math.inf
    high: float = math.inf
    above: bool = False  # the lower bound itself is not allowed
    below: bool = False  # the upper bound itself is not allowed
    also: float | None = None
    whole: bool = False  # only whole numbers are allowed
    default: float | None = None
    meaning: str = ""
    source: str = ""

    def admits(self, number: float) -> bool:
        """Return whether a number is allowed; NaN never is."""
        over = number > self.low if self.above else number >= self.low
        under = number < self.high if self.below else number <= self.high
        return (over and under) or number == self.also

    def takes(self, value: object) -> TypeGuard[float]:
        """Return whether a value is an allowed number."""
        return is_number(value) and (isinstance(value, Integral) or not self.whole) and self.admits(value)

    @property
    def bounds(self) -> str:
        """Return the allowed numbers with their unit, or an empty text without bounds."""
        low = f"above {self.low:g}" if self.above else f"{self.low:g}"
        high = f"below {self.high:g}" if self.below else f"{self.high:g}"
        unit = "" if self.unit == PURE else f" {self.unit}"
        match math.isfinite(self.low), math.isfinite(self.high):
            case True, True:
                at_most = high if self.below else f"at most {high}"
                text = f"{low}, {at_most}" if self.above else f"{low} to {high}"
            case True, False:
                text = low if self.above else f"{low} or more"
            case False, True:
                text = high if self.below else f"at most {high}"
            case _:
                return ""
        outside = self.also is not None and not self.low <= self.also <= self.high
        return text + unit + (f", or {self.also:g} for none" if outside else "")

    def __str__(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        if self.bounds:
            return f"{self.bounds}, {kind}" if self.whole else self.bounds
        return kind if self.unit == PURE else f"{kind} in {self.unit}"

    def complaint(self, value: object) -> str:
        """Describe a value that is not allowed: `is 250; allowed -0.3 to 0.3 m; if you meant 250 mm, write 0.25`."""
        hint = self.hint(value)
        return f"is {shown(value)}; allowed {self}" + (f"; {hint}" if hint else "")

    def hint(self, value: object) -> str:
        """Guess the intended number from one in another unit or from a text; empty if no guess is allowed."""
        if isinstance(value, str):
            bare = "a bare number" if self.unit == PURE else f"a bare number in {self.unit}"
            match = _NUMBER.fullmatch(value)
            worth = ({"": 1.0, self.unit: 1.0} | UNITS.get(self.unit, {})).get(match[2]) if match else None
            meant = f"{float(match[1]) * worth:.6g}" if match and worth else ""
            return f"write {bare}: {meant}" if meant and self._allowed(meant) else f"write {bare}"
        if is_number(value) and abs(value) < _HUGE and not self.whole:
            for unit, worth in UNITS.get(self.unit, {}).items():
                if self._allowed(meant := f"{value * worth:.4g}"):
                    return f"if you meant {value:g} {unit}, write {meant}"
        return ""

    def _allowed(self, text: str) -> bool:
        return math.isfinite(float(text)) and self.admits(float(text))


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a number of any library; true and false are no numbers."""
    return isinstance(value, Real) and not isinstance(value, bool)


def factor(unit: str) -> tuple[float, str]:
    """Return the factor of a unit to its base unit, and the base unit; any unit may also be per s or s^2.

    Raises:
        ValueError: The unit is unknown; the text lists the known ones.
    """
    plain = " ".join(unit.split()).translate(_SIGNS)
    plain = _PRODUCTS.get(plain, plain)
    for own, others in UNITS.items():
        if plain == own:
            return 1.0, own
        if plain in others:
            return others[plain], own
    if rate := re.fullmatch(r"(.*[^ ]) ?(/ ?s(?:\^2)?)", plain):
        with contextlib.suppress(ValueError):
            worth, own = factor(rate[1])
            return worth, own + rate[2].replace(" ", "")
    known = {own: others for own, others in UNITS.items() if own in _COLUMNS}
    names = [name for own, others in known.items() for name in (own, *others)]
    same = [name for name in names if name.lower() == plain.lower()]
    near = f"did you mean {' or '.join(same)}? " if same else did_you_mean(plain, names)
    raise ValueError(f"no unit {shown(unit)}; {near}allowed {', '.join(names)}, and these per second (V/s, deg/s^2)")


def with_unit(name: str, unit: str) -> str:
    """Return a name with its unit as in columns and keys: `pressure_kpa`, `rate_m_s`; a pure number has no unit."""
    return name if unit in (PURE, "1") else "_".join((name, *re.findall(r"[a-z0-9]+", unit.lower())))


def shown(value: object) -> str:
    """Show a value as YAML would, no more than a line of it."""
    match value:
        case None:
            return "null"
        case bool():
            return str(value).lower()
        case int() if abs(value) < _HUGE:
            return str(value)
        case int():
            return "beyond 1e15"
        case float():
            return f"{value:.6g}"
        case dict():
            return "a group"
        case list() | tuple():
            return "a list"
        case str() | Path():
            return f"{str(value)[:80]!r}"
    return str(value)
