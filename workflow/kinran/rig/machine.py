"""The body of the simulated goniometer: arms, lamp, shutter and jobs on a virtual clock.

Time passes only through `Machine.advance`. The state that a camera sees is public: `pose`, `lamp_output`,
`shutter_open`.
"""

import math
import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace

from kinran.rig.motion import AXES, meeting, move_time, travel_time, travelled
from kinran.rig.motion import Four as Axes
from kinran.rig.protocol import Config, Expose, Fault, Flag, Four, JobState, Move, Opcode, State, Status
from kinran.rig.simulated_lamp import PHOTODIODE, WARM_UP_S, lamp_output

HOMING_S = 5.0
"""Duration of simulated homing in seconds: made up."""
NO_AXIS = 0xFF
"""Axis of a fault that has none (docs/rig.md, status block)."""
Verdict = Status | Callable[[], Status]
"""Status of a command that is refused, or what is left to do of one that is not."""
_ALL_AXES = 0b1111
_IDLE_EVENT_S, _MOVING_EVENT_S = 1.0, 0.1
"""Seconds between events, at rest and in motion (docs/rig.md, Protocol)."""


class Machine:
    """Arms, lamp, shutter and jobs of a simulated goniometer.

    Parameters
    ----------
    seed
        Seed of the small errors of mechanics and encoders; the same target always gets the same ones.
    axes
        Limits, speeds and accelerations.
    homing_s
        Duration of homing in seconds.

    Attributes
    ----------
    lamp_factor
        Share of its nominal light that the lamp gives; tests change it.
    release
        Function that the camera's release line calls with the shutter time in seconds.
    jobs_done
        Jobs that came to their end, with the pose there in millidegrees.
    """

    def __init__(self, seed: int = 0, axes: Axes = AXES, homing_s: float = HOMING_S) -> None:
        self.seed = seed
        self.axes = axes
        self.homing_s = homing_s
        self._counts_edges = True
        self.lamp_factor = 1.0
        self.release: Callable[[float], None] | None = None
        self.jobs_done: list[tuple[Opcode, Four]] = []
        self._now = 0.0
        self._interlock = False
        self._start: tuple[float, ...] = (20_000.0, 15_000.0, 0.0, 0.0)
        self._factory = Config(
            low=_four(axis.low for axis in axes),
            high=_four(axis.high for axis in axes),
            speeds=_four(axis.speed // 10 for axis in axes),
            accelerations=_four(axis.acceleration // 1000 for axis in axes),
            watchdog_ms=2000,
            homing_s=math.ceil(homing_s),
        )
        self._config = self._factory
        self._reset()

    def _reset(self) -> None:
        """Set the state after power-on: pose unknown, lamp off."""
        self._booted = self._fed = self._now
        self._end = self._start
        self._encoder_error: tuple[float, ...] = (0.0,) * 4
        self._homed = self._homing = 0
        self._job = 0
        self._opcode = Opcode.NOP
        self._job_state = JobState.IDLE
        self._job_start = 0.0
        self._job_end = self._stall_at = math.inf
        self._motion = self.axes
        self._releases: deque[float] = deque()
        self._gap_s, self._judge_at, self._edges = 0.0, math.inf, 0
        self._fault, self._fault_axis = Fault.INTERLOCK if self._interlock else Fault.NONE, NO_AXIS
        self._lit_at: float | None = None
        self._shutter, self._shutter_since, self._shutter_until = False, 0.0, math.inf
        self._light, self._looked = 0.0, 0.0
        self._photodiode = 0
        self._exposures = self._batch = self._events = 0
        self._watchdog_s = self._config.watchdog_ms / 1000
        self._next_event = self._now + _IDLE_EVENT_S

    def on_event(self) -> None:
        """Report an event to the host."""

    # -- what a camera sees --------------------------------------------------------------------------

    @property
    def clock(self) -> float:
        """Seconds since the simulation began."""
        return self._now

    @property
    def uptime(self) -> float:
        """Seconds since the firmware started."""
        return self._now - self._booted

    @property
    def pose(self) -> tuple[float, ...]:
        """True pose in millidegrees: light θ, light φ, camera θ, camera φ."""
        if self._job_state is not JobState.RUNNING or self._start == self._end:
            return self._start
        f = self._fraction()
        return tuple(a + (b - a) * f for a, b in zip(self._start, self._end, strict=True))

    @property
    def lamp_on(self) -> bool:
        """Whether the lamp burns."""
        return self._lit_at is not None

    @property
    def shutter_open(self) -> bool:
        """Whether the lamp's shutter is open."""
        return self._shutter

    @property
    def lamp_seconds(self) -> float:
        """Seconds since the lamp was lit; 0 while it is off."""
        return 0.0 if self._lit_at is None else self._now - self._lit_at

    @property
    def lamp_output(self) -> float:
        """Relative light of the lamp: 1 is nominal, 0 is off; it warms up, breathes and ages."""
        return lamp_output(self.lamp_seconds) * self.lamp_factor if self.lamp_on else 0.0

    def sync(self) -> None:
        """Count an X-sync edge of the camera: one exposure was taken."""
        self._exposures += 1

    # -- faults from outside -------------------------------------------------------------------------

    def trip(self, fault: Fault, axis: int = NO_AXIS) -> None:
        """Latch a fault: motion stops, the shutter closes, the lamp stays lit unless it is the lamp."""
        self._halt(JobState.FAULTED)
        self._fault, self._fault_axis = fault, axis
        self._close()
        if fault is Fault.LAMP_OUT:
            self._set_lamp(0)
        self._emit_event()

    def set_interlock(self, is_open: bool) -> None:
        """Open or close the door."""
        opened, self._interlock = is_open and not self._interlock, is_open
        if opened:
            self.trip(Fault.INTERLOCK)

    # -- time ----------------------------------------------------------------------------------------

    def advance(self, seconds: float) -> None:
        """Let time pass, with all events that fall due."""
        until = self._now + seconds
        while True:
            due, act = min(self._timers(), key=lambda timer: timer[0])
            if due > until:
                break
            self._now = max(self._now, due)
            act()
        self._now = until

    def next_due(self) -> float:
        """Return the clock, in seconds, at which the next timer falls due."""
        return min(due for due, _ in self._timers())

    def _timers(self) -> list[tuple[float, Callable[[], object]]]:
        timers: list[tuple[float, Callable[[], object]]] = [
            (self._next_event, self._emit_event),
            (self._judge_at, self._judge),
            (self._job_end, self._finish),
            (self._stall_at, self._stall),
            (self._shutter_until, self._close),
        ]
        busy = self._job_state is JobState.RUNNING or self._shutter
        if busy and self._watchdog_s and not self._fault:
            timers.append((self._fed + self._watchdog_s, lambda: self.trip(Fault.WATCHDOG)))
        return timers

    # -- state ---------------------------------------------------------------------------------------

    def state(self) -> State:
        """Return the STATUS block."""
        flags = self._homed << Flag.HOMED
        if self._job_state is JobState.RUNNING:
            moving = [a != b for a, b in zip(self._start, self._end, strict=True)]
            if self._opcode is Opcode.HOME:
                moving = [bool(self._homing >> i & 1) for i in range(4)]
            flags |= sum(m << (Flag.MOVING + i) for i, m in enumerate(moving))
        flags |= self._shutter << Flag.SHUTTER | self.lamp_on << Flag.LAMP
        flags |= (self._watchdog_s > 0) << Flag.WATCHDOG | (self._fault != 0) << Flag.FAULT
        flags |= self._interlock << Flag.INTERLOCK
        flags |= (self.lamp_seconds >= WARM_UP_S) << Flag.LAMP_WARM
        return State(
            uptime_ms=int(self.uptime * 1000) & 0xFFFFFFFF,
            position=self._encoders(),
            flags=flags,
            fault=self._fault,
            fault_axis=self._fault_axis,
            job=self._job,
            job_state=self._job_state,
            batch=self._batch,
            exposures=self._exposures,
            photodiode=self._photodiode,
            event=self._events,
        )

    def _encoders(self) -> Four:
        pairs = zip(self.pose, self._encoder_error, strict=True)
        return _four(round(p + e) if self._homed >> i & 1 else 0 for i, (p, e) in enumerate(pairs))

    def _emit_event(self) -> None:
        self._events += 1
        running = self._job_state is JobState.RUNNING
        self._next_event = self._now + (_MOVING_EVENT_S if running else _IDLE_EVENT_S)
        self.on_event()

    # -- commands: each is checked first, and returns its status, or what is left to do -----------------

    def _names_fault(self, seen: int) -> bool:
        """Return whether CLEAR may clear what the host saw: no other fault, and no door that is still open."""
        return seen == self._fault and not (self._fault is Fault.INTERLOCK and self._interlock)

    def _clear(self, seen: int) -> Status:
        if seen:
            self._fault, self._fault_axis = Fault.NONE, NO_AXIS
            self._job_state = JobState.IDLE
        return Status.OK

    def _home(self, mask: int) -> Verdict:
        """Home some axes, which have no pose until that is done."""
        if not 0 < mask <= _ALL_AXES:
            return Status.BAD_ARG

        def home() -> Status:
            end = tuple(self._rest(i, 0) if mask >> i & 1 else at for i, at in enumerate(self._start))
            self._homing = mask
            self._homed &= ~mask
            self._motion = self._configured()
            return self._run(Opcode.HOME, end, self.homing_s)

        return home

    def _move(self, move: Move) -> Verdict:
        """Move some axes, all at once; where all stand must be known, or nobody knows whether the arms meet."""
        if move.mask & ~_ALL_AXES:
            return Status.BAD_ARG
        if self._homed != _ALL_AXES:
            return Status.NOT_HOMED
        axes = [i for i in range(4) if move.mask >> i & 1]
        if any(not self._config.low[i] <= move.targets[i] <= self._config.high[i] for i in axes):
            return Status.LIMIT
        end = tuple(self._rest(i, move.targets[i]) if i in axes else self._start[i] for i in range(4))
        if meeting(self._start, end):
            return Status.COLLISION

        def go() -> Status:
            errors = list(self._encoder_error)
            for i in axes:
                errors[i] = 2 * self._jitter(i, move.targets[i], b"encoder")
            self._encoder_error = tuple(errors)
            self._motion = self._configured(move.speeds)
            seconds = move_time(self._start, end, self._motion)
            return self._run(Opcode.MOVE, end, seconds + move.settle_ms / 1000)

        return go

    def _set_lamp(self, on: int) -> Status:
        self._look()
        if not on:
            self._lit_at = None
        elif self._lit_at is None:
            self._lit_at = self._now
        return Status.OK

    def _open(self, seconds: float) -> Status:
        if not self._shutter:
            self._shutter, self._shutter_since = True, self._now
            self._light, self._looked = 0.0, self._now
        self._shutter_until = self._now + seconds
        return Status.OK

    def _close(self) -> Status:
        if self._shutter:
            self._look()
            seconds = self._now - self._shutter_since
            self._photodiode = round(self._light / seconds) if seconds else self._measure(0)
        self._shutter, self._shutter_until = False, math.inf
        return Status.OK

    def _look(self) -> None:
        """Add the light since the last look to that of the open window; a lamp is as it is in the middle of a while."""
        seconds = self._now - self._looked
        self._light += seconds * self._measure(seconds / 2)
        self._looked = self._now

    def _stop(self) -> Status:
        self._halt(JobState.STOPPED)
        return Status.OK

    def _watch(self, seconds: float) -> Status:
        self._watchdog_s = seconds
        return Status.OK

    def _expose(self, batch: Expose) -> Status:
        self._gap_s = batch.gap_ms / 1000
        self._releases.extend(time_us / 1e6 for time_us in batch.open_us)
        self._batch = 0
        status = self._run(Opcode.EXPOSE, self._start, math.inf)
        self._judge_at = self._now
        self._fire()
        return status

    def _fire(self) -> None:
        seconds = self._releases.popleft()
        self._edges = self._exposures
        self._judge_at += seconds + self._gap_s
        if self.release is not None:
            self.release(seconds)

    def _judge(self) -> None:
        """Look for the X-sync edge of an exposure when its open time and the gap are over, and go on to the next."""
        if self._counts_edges and self._exposures == self._edges:
            self.trip(Fault.XSYNC_MISSING)
            return
        self._batch += 1
        if self._releases:
            self._fire()
        else:
            self._finish()

    # -- jobs ----------------------------------------------------------------------------------------

    def _run(self, opcode: Opcode, end: tuple[float, ...], seconds: float) -> Status:
        self._job = self._job % 255 + 1
        self._opcode, self._job_state = opcode, JobState.RUNNING
        self._job_start, self._job_end = self._now, self._now + seconds
        self._end = end
        self._next_event = self._now + _MOVING_EVENT_S
        return Status.ACCEPTED

    def _finish(self) -> None:
        self._job_end = self._judge_at = math.inf
        self._job_state = JobState.DONE
        self._start = self._end
        if self._opcode is Opcode.HOME:
            self._homed |= self._homing & _ALL_AXES
        if self._opcode is Opcode.INTENSITY:
            self._photodiode = self._measure((self._now - self._job_start) / 2)
        self.jobs_done.append((self._opcode, _four(round(p) for p in self._start)))
        self._emit_event()

    def _stall(self) -> None:
        moved = [abs(b - a) for a, b in zip(self._start, self._end, strict=True)]
        self.trip(Fault.STALL, moved.index(max(moved)))

    def _halt(self, state: JobState) -> None:
        if self._job_state is JobState.RUNNING:
            self._start = self.pose
            self._job_state = state
        self._end = self._start
        self._job_end = self._stall_at = self._judge_at = math.inf
        self._releases.clear()

    def _configured(self, speeds: Four = (0, 0, 0, 0)) -> Axes:
        """Return the axes as CONFIG and a move's own speeds hold them back."""
        config = zip(self.axes, self._config.speeds, self._config.accelerations, speeds, strict=True)
        a, b, c, d = (
            replace(
                axis,
                speed=min(axis.speed, 10 * top or axis.speed, speed or axis.speed),
                acceleration=min(axis.acceleration, 1000 * acceleration or axis.acceleration),
            )
            for axis, top, acceleration, speed in config
        )
        return a, b, c, d

    def _fraction(self) -> float:
        """Return the share of the running job's path that is done; the slowest axis sets the pace."""
        paths = [
            (travel_time(b - a, axis.speed, axis.acceleration), b - a, axis)
            for a, b, axis in zip(self._start, self._end, self._motion, strict=True)
        ]
        _, distance, axis = max(paths, key=lambda path: path[0])
        return travelled(distance, axis.speed, axis.acceleration, self._now - self._job_start)

    def _rest(self, axis: int, target: int) -> float:
        return target + 3 * self._jitter(axis, target, b"mechanics")

    def _jitter(self, axis: int, target: int, salt: bytes) -> float:
        """Return a pseudo-random number in [-1, 1] that depends on the target alone."""
        digest = zlib.crc32(struct.pack("<qBi", self.seed, axis, target) + salt)
        return digest / 0x7FFFFFFF - 1

    def _measure(self, ago: float) -> int:
        if self._lit_at is None:
            return 0
        return round(PHOTODIODE * lamp_output(self.lamp_seconds - ago) * self.lamp_factor)


def _four(values: Iterable[int]) -> Four:
    a, b, c, d = values
    return a, b, c, d
