"""Rail drive of the twin: the behaviour of a dryve D1 (`DryveDevice`) behind a TCP port (`DryveServer`).

The D1's behaviour without a master is not documented. Here it brakes on its quick-stop ramp when the connection ends,
or when no telegram has arrived for 0.1 s in operation: an ASSUMPTION, see docs/reference/wires.md.
"""

import asyncio
import contextlib
from collections.abc import Callable
from enum import Enum, auto

from softarm.drivers.base import DeviceError
from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import STATES, DriveState, StatusWord
from softarm.drivers.rail.dryve import Entry, ModbusRequest
from softarm.drivers.twin.faults import Faults
from softarm.schemas.config import DryveRail
from softarm.schemas.robot import RAIL_TRAVEL_M

SILENCE_MAX_S = 0.1
AT_REST_M_S = 0.02
REACHED_M_S = 0.01
LIMIT_SWITCH, FOLLOWING_ERROR = 0xFF00, 0x8611
# Bits of the controlword.
START, HALT = 0x0010, 0x0100
# PP, PV, homing and CSP: all modes of the D1.
MODES = (1, 3, 6, 8)
# Homing method of CiA 402: the edge of the negative limit switch.
METHOD = 17
# Below this position of the cart the switch is closed.
SWITCH_M = -(RAIL_TRAVEL_M - 0.015)

_STATE_BITS = {state: value for _, value, state in STATES}
_READ_ONLY = (
    dryve.STATUSWORD,
    dryve.MODE_DISPLAY,
    dryve.POSITION,
    dryve.VELOCITY,
    dryve.ERROR_CODE,
    dryve.HOMING_METHOD,
    dryve.HOMING_STATUS,
)
_ENTRIES = {(entry.index, entry.sub): entry for entry in vars(dryve).values() if isinstance(entry, Entry)}
_ABSENT, _NOT_WRITABLE, _TOO_LONG, _OUT_OF_RANGE = 0x06020000, 0x06010002, 0x06070012, 0x06090030


class _Search(Enum):
    TO_THE_SWITCH = auto()
    OFF_THE_SWITCH = auto()


class Reference:
    """Zero and homing of the drive, by the limit switch at the negative end of the rail. Pure.

    `offset_m` is the error of the axis position, 0 on a homed axis. `attained` and `failed` describe the newest search.
    """

    def __init__(self) -> None:
        self.homed, self.offset_m = True, 0.0
        self.attained = self.failed = False
        self._search: _Search | None = None

    @property
    def searching(self) -> bool:
        """Whether a search is running."""
        return self._search is not None

    def forget(self, axis_m: float) -> None:
        """Lose the zero, as an incremental axis does without supply: its position becomes the new zero."""
        self.homed, self.offset_m = False, -axis_m
        self.attained = self.failed = False
        self._search = None

    def begin(self, speed: int) -> None:
        """Begin a search; with zero speed it fails at once."""
        self.attained, self.failed = False, speed == 0
        self._search = None if self.failed else _Search.TO_THE_SWITCH

    def cancel(self) -> None:
        """Cancel a running search."""
        self._search = None

    def update(self, position_m: float) -> None:
        """Advance the search by the cart's position from the middle of the rail."""
        closed = position_m <= SWITCH_M
        if self._search is _Search.TO_THE_SWITCH and closed:
            self._search = _Search.OFF_THE_SWITCH
        elif self._search is _Search.OFF_THE_SWITCH and not closed:
            self._search = None
            self.homed, self.offset_m, self.attained = True, 0.0, True

    def velocity(self, speed: int, creep: int) -> int:
        """Return the velocity of the search, in the units of the two speeds."""
        match self._search:
            case _Search.TO_THE_SWITCH:
                return -speed
            case _Search.OFF_THE_SWITCH:
                return creep
        return 0


class DryveDevice:
    """Behaviour of the drive. Pure: telegrams, the time and the cart's motion go in, answers and a velocity come out.

    The ramps are the simulator's; 6083h to 6085h are stored without effect. `moved_ns` is the time of the newest
    set-point that moves the cart, `halted_ns` the time since which none does. `keeps_going` disables the watchdog.
    """

    def __init__(self, config: DryveRail) -> None:
        self.remote = True
        self.keeps_going = False
        self.moved_ns: int | None = None
        self.halted_ns: int | None = None
        self._units_per_m, self._centre_m = config.units_per_m, config.centre_m
        self.reference = Reference()
        self._received_ns = 0
        self._position_m = self._velocity_m_s = 0.0
        self._switch_on()

    def _switch_on(self) -> None:
        self.state = DriveState.SWITCH_ON_DISABLED
        self._values = dict.fromkeys(_ENTRIES.values(), 0) | {dryve.HOMING_METHOD: METHOD}

    def power_cycle(self) -> None:
        """Lose all settings and the zero: the present position reads 0 afterwards."""
        self._switch_on()
        self.reference.forget(self._position_m + self._centre_m)
        self.sense(self._position_m, self._velocity_m_s)

    @property
    def in_operation(self) -> bool:
        """Whether the drive is in the CiA 402 state operation enabled."""
        return self.state is DriveState.OPERATION_ENABLED

    @property
    def target_velocity_m_s(self) -> float:
        """Velocity of the motor; zero unless in operation, not halted, and with a set-point or a search."""
        if not self.in_operation or self._values[dryve.CONTROLWORD] & HALT:
            return 0.0
        match self._values[dryve.MODE]:
            case dryve.PROFILE_VELOCITY:
                return self._values[dryve.TARGET_VELOCITY] / self._units_per_m
            case dryve.HOMING:
                speeds = (self._values[dryve.HOMING_SPEED], self._values[dryve.HOMING_CREEP])
                return self.reference.velocity(*speeds) / self._units_per_m
        return 0.0

    def answer(self, telegram: bytes, now_ns: int) -> bytes:
        """Return the answer to one telegram."""
        self._received_ns = now_ns
        try:
            request = dryve.decode_request(telegram)
        except ValueError:
            return dryve.encode_exception(int.from_bytes(telegram[:2], "big"), 0x03)
        entry = _ENTRIES.get((request.index, request.sub))
        if entry is None:
            return dryve.encode_abort(request.transaction, _ABSENT)
        if request.data is None:
            value = self._read(entry).to_bytes(entry.size, "little", signed=entry.signed)
            return dryve.encode_value(request, value[: request.count])
        abort = self._write(entry, request)
        if abort is not None:
            return dryve.encode_abort(request.transaction, abort)
        self._record(now_ns, set_point=entry == dryve.TARGET_VELOCITY)
        return dryve.encode_acknowledgement(request)

    def sense(self, position_m: float, velocity_m_s: float) -> None:
        """Set the encoder's position and velocity."""
        self._position_m, self._velocity_m_s = position_m, velocity_m_s
        if not self.in_operation:
            self.reference.cancel()
        self.reference.update(position_m)
        axis_m = position_m + self._centre_m + self.reference.offset_m
        self._values[dryve.POSITION] = round(axis_m * self._units_per_m)
        self._values[dryve.VELOCITY] = round(velocity_m_s * self._units_per_m)

    def watch(self, now_ns: int) -> None:
        """Brake without a master or with DI7 low, and end a quick stop at rest."""
        if now_ns - self._received_ns > SILENCE_MAX_S * 1e9:
            self.lose_master()
        if not self.remote:
            self.quick_stop()
        if self.state is DriveState.QUICK_STOP and abs(self._velocity_m_s) < AT_REST_M_S:
            self.state = DriveState.SWITCH_ON_DISABLED
        if not self.remote and self.state in (DriveState.READY, DriveState.SWITCHED_ON):
            self.state = DriveState.SWITCH_ON_DISABLED
        self._record(now_ns)

    def lose_master(self) -> None:
        """Brake because the master is gone, unless `keeps_going`."""
        if not self.keeps_going:
            self.quick_stop()

    def quick_stop(self) -> None:
        """Brake if in operation; at rest `watch` disables the drive."""
        if self.in_operation:
            self.state = DriveState.QUICK_STOP

    def trip(self, error_code: int) -> None:
        """Enter the fault state with an error code of 603Fh."""
        self.state = DriveState.FAULT
        self._values[dryve.ERROR_CODE] = error_code

    def _record(self, now_ns: int, set_point: bool = False) -> None:
        moving = self.target_velocity_m_s != 0
        if moving and set_point:
            self.moved_ns, self.halted_ns = now_ns, None
        elif not moving and self.halted_ns is None:
            self.halted_ns = now_ns

    def _read(self, entry: Entry) -> int:
        if entry == dryve.STATUSWORD:
            return self._statusword()
        if entry == dryve.HOMING_STATUS:
            return int(self.reference.homed)
        return self._values[dryve.MODE if entry == dryve.MODE_DISPLAY else entry]

    def _statusword(self) -> int:
        word = _STATE_BITS[self.state]
        word |= StatusWord.REMOTE if self.remote else 0
        if self._values[dryve.MODE] == dryve.HOMING:
            word |= 0 if self.reference.searching else StatusWord.TARGET_REACHED
            word |= StatusWord.HOMING_ATTAINED if self.reference.attained else 0
            return word | (StatusWord.HOMING_ERROR if self.reference.failed else 0)
        reached = abs(self._velocity_m_s - self.target_velocity_m_s) < REACHED_M_S
        word |= StatusWord.TARGET_REACHED if reached else 0
        word |= StatusWord.AT_REST if self.in_operation and abs(self._velocity_m_s) < AT_REST_M_S else 0
        return word

    def _write(self, entry: Entry, request: ModbusRequest) -> int | None:
        """Store a value and return None, or the SDO abort code of a refusal."""
        if entry in _READ_ONLY:
            return _NOT_WRITABLE
        data = request.data or b""
        if len(data) > entry.size:
            return _TOO_LONG
        value = int.from_bytes(data, "little", signed=entry.signed)
        if entry == dryve.MODE and value not in MODES:
            return _OUT_OF_RANGE
        if entry == dryve.CONTROLWORD:
            self._control(value)
        self._values[entry] = value
        return None

    def _control(self, word: int) -> None:
        """Apply the transitions of CiA 402, figure "state machine", that a controlword can cause."""
        before = self._values[dryve.CONTROLWORD]
        reset = word & 0x80 and not before & 0x80
        if not self.remote:
            return
        if word & HALT or not word & START:
            self.reference.cancel()
        elif self.in_operation and not before & START and self._values[dryve.MODE] == dryve.HOMING:
            self.reference.begin(self._values[dryve.HOMING_SPEED])
        if self.state is DriveState.FAULT:
            if reset:
                self.state = DriveState.SWITCH_ON_DISABLED
                self._values[dryve.ERROR_CODE] = 0
            return
        if self.state is DriveState.QUICK_STOP:
            return
        on = self.state in (DriveState.READY, DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED)
        # Disable voltage.
        if not word & 0x02:
            self.state = DriveState.SWITCH_ON_DISABLED
        elif not word & 0x04:
            if self.in_operation:
                self.quick_stop()
            else:
                self.state = DriveState.SWITCH_ON_DISABLED
        elif not word & 0x01:
            self.state = DriveState.READY
        elif on and not word & 0x08:
            self.state = DriveState.SWITCHED_ON
        elif self.state is DriveState.SWITCHED_ON:
            self.state = DriveState.OPERATION_ENABLED


class DryveServer:
    """TCP server of a `DryveDevice` for one master at a time; a new master replaces the old."""

    def __init__(self, host: str, port: int, device: DryveDevice, faults: Faults, clock: Callable[[], int]) -> None:
        self.device, self.host, self.port = device, host, port
        self._faults, self._clock = faults, clock
        self._server: asyncio.Server | None = None
        self._master: asyncio.StreamWriter | None = None

    async def open(self) -> None:
        """Listen; port 0 lets the system choose, and `port` becomes its choice. Raises DeviceError on failure."""
        try:
            self._server = await asyncio.start_server(self._serve, self.host, self.port)
        except OSError as error:
            remedy = "set drivers.rail.host to 127.0.0.1 and drivers.rail.port to a free port above 1023"
            raise DeviceError(f"{self.host}:{self.port}", "listen as the rail", str(error), remedy) from error
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Disconnect the master and stop listening."""
        self._disconnect()
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    def step(self) -> None:
        """Apply the faults, and check the drive's watchdog and inputs."""
        self.device.remote = not self._faults.active("remote_low")
        self.device.keeps_going = self._faults.active("rail_keeps_going")
        if self._faults.take("rail_drop_connection"):
            self._disconnect()
        if self._faults.take("rail_unreferenced"):
            self._disconnect()
            self.device.power_cycle()
        if self._faults.take("rail_fault"):
            self.device.trip(FOLLOWING_ERROR)
        self.device.watch(self._clock())

    def _disconnect(self) -> None:
        if self._master is not None:
            self._master.transport.abort()
            self._master = None
            self.device.lose_master()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._disconnect()
        self._master = writer
        telegrams = dryve.Telegrams()
        with contextlib.suppress(OSError, ValueError):
            while data := await reader.read(4096):
                telegrams.feed(data)
                while (telegram := telegrams.next()) is not None:
                    if not self._faults.active("rail_silence"):
                        await self._reply(writer, self.device.answer(telegram, self._clock()))
        if self._master is writer:
            self._disconnect()

    async def _reply(self, writer: asyncio.StreamWriter, answer: bytes) -> None:
        if not self._faults.active("rail_segment"):
            writer.write(answer)
            return
        for byte in answer:
            writer.write(bytes((byte,)))
            await asyncio.sleep(0)
