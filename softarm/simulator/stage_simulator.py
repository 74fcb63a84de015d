"""Batch simulator that runs a whole recording of one stage in a single call of the kernel."""

from softarm.simulator import kernel
from softarm.simulator.kernel import layout
from softarm.simulator.simulator import Array, Simulator


class StageSimulator(Simulator):
    """Simulator of one stage with recorded inputs; the results have the same bits as those of the single steps."""

    def fly_pressure(self, pressure_kpa: Array, late_s: Array, step_s: float) -> Array:
        """Return the pressure at the start of every step, kPa [T, R].

        Args:
            pressure_kpa: commands, [T, R].
            late_s: delay of each command, s [T, R].
            step_s: duration of each command, s.
        """
        self._given |= layout.PRESSURE  # keeps the history of pressure commands
        return self._fly(kernel.fly_pressure, layout.CART_GIVEN, step_s, pressure_kpa, late_s)

    def fly_cart(self, cart_velocity_m_s: Array, arm_force_n: Array, late_s: Array, step_s: float) -> Array:
        """Return the cart's velocity at the start of every step, m/s [T, R].

        Args:
            cart_velocity_m_s: commands, [T, R].
            arm_force_n: force of the arm on the cart, [T, R].
            late_s: delay of each command, s [T, R].
            step_s: duration of each command, s.
        """
        self._given |= layout.PRESSURE
        return self._fly(kernel.fly_cart, layout.PRESSURE_GIVEN, step_s, cart_velocity_m_s, arm_force_n, late_s)

    def fly_arm(self, cart_position_m: Array, cart_velocity_m_s: Array, pressure_kpa: Array, step_s: float) -> Array:
        """Return y, then z of every link's end at the start of every step, m [T, 2 n, R].

        Within a step the cart follows the cubic through both ends and the pressure a straight line.

        Args:
            cart_position_m: at the start of every step, [T, R].
            cart_velocity_m_s: likewise, [T, R].
            pressure_kpa: likewise, [T, R].
            step_s: length of a step, s.
        """
        given = layout.CART_GIVEN | layout.PRESSURE_GIVEN
        inputs = cart_position_m, cart_velocity_m_s, pressure_kpa
        return self._fly(kernel.fly_arm, given, step_s, *inputs, further=(step_s,), rows=(2 * self.links,))
