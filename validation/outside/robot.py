"""Robot without the wires: body, drive, firmware and the record of the cart."""

from .body import STOP_M, Body
from .drive import Drive
from .regulator import Firmware

STEP_S = 0.001
_CRASHED = 0xFF00
_CLEAR_M = 0.001  # distance from the stop after which a touch is another crash


class Robot:
    """Robot that moves by `step` and counts crashes and excursions beyond `bound_m`, once until the cart is back."""

    def __init__(self, body: Body, drive: Drive, bound_m: float) -> None:
        self.body, self.drive, self.firmware = body, drive, Firmware()
        self.max_cart_m = 0.0
        self.excursions = 0
        self.crashes = 0
        self._bound_m = bound_m
        self._beyond = self._touching = False

    def step(self, now: float) -> None:
        """Advance by STEP_S from `now` (s)."""
        body = self.body
        force_n, servo_ns_m = self.drive.step(STEP_S, now, body.cart_m, body.cart_m_s)
        body.step(STEP_S, self.firmware.set_kpa, force_n, servo_ns_m)
        away = abs(body.cart_m)
        self.max_cart_m = max(self.max_cart_m, away)
        beyond = away > self._bound_m
        self.excursions += beyond and not self._beyond
        self._beyond = beyond
        touching = away > STOP_M - _CLEAR_M if self._touching else away >= STOP_M
        if touching and not self._touching:
            self.crashes += 1
            self.drive.trip(_CRASHED)
        self._touching = touching

    def truth(self) -> dict[str, float]:
        """Return the record of the cart for a JSON file."""
        return {"max_cart_m": self.max_cart_m, "excursions": self.excursions, "crashes": self.crashes}
