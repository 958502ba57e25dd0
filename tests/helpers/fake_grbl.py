"""A serial port with a GRBL 1.1 controller and its two rotation axes behind it, on a virtual clock."""

from collections import deque

from kinran.rig.motion import travel_time, travelled

SETTINGS = {"10": "1", "22": "1", "110": "600.000", "111": "1800.000", "120": "20.000", "121": "60.000"}
"""Settings of the controller: report of machine positions, homing, speeds in °/min, accelerations in °/s²."""
HOMING_S = 8.0


class FakeGrbl:
    """The controller; to `capture_bench.FakeCamera` it looks like the firmware of a rig.

    Attributes
    ----------
    fails
        Whether the cable is out.
    lines
        Lines of G-code and ``$`` commands that came in.
    """

    lamp_output = 1.0
    shutter_open = True

    def __init__(self) -> None:
        self.clock = 0.0
        self.fails = False
        self.closed = False
        self.lines: list[str] = []
        self.off_target = 0.0
        self._out: deque[bytes] = deque()
        self._in = b""
        self.switch_on()

    def switch_on(self) -> None:
        """Forget the pose; homing is asked for."""
        self._state = "Alarm"
        self._dead = False  # until a reset, after a hard limit
        self._from = self._to = (12.0, 34.0)
        self._began = self._until = 0.0
        self._feed = 0
        self._hold_at: float | None = None
        self._pending: list[tuple[float, bytes]] = []
        self._say("", "Grbl 1.1h ['$' for help]", "[MSG:'$H'|'$X' to unlock]")

    def hit_limit(self) -> None:
        """Press a limit switch: GRBL stops at once, and answers to nothing but a reset and ``?``."""
        self._from = self._to = self._where()
        self._state, self._dead, self._until = "Alarm", True, 0.0
        self._pending.clear()
        self._say("ALARM:1", "[MSG:Reset to continue]")

    def sleep(self, seconds: float) -> None:
        self.clock += seconds
        for due, line in [each for each in self._pending if each[0] <= self.clock]:
            self._pending.remove((due, line))
            self._out.append(line)
        if self._state in ("Run", "Home") and self.clock >= self._until:
            self._from, self._state = self._to, "Idle"
        if self._hold_at is not None and self.clock >= self._hold_at:
            self._state = "Hold"

    @property
    def pose(self) -> tuple[float, ...]:
        """True pose in millidegrees."""
        theta, phi = self._where()
        return 1000 * theta, 1000 * phi, 0.0, 0.0

    def _where(self) -> tuple[float, float]:
        if self._state not in ("Run", "Hold") or self._from == self._to:
            return self._from
        at = self.clock if self._hold_at is None else min(self.clock, self._hold_at)
        pairs = list(zip(self._from, self._to, (10.0, 30.0), (20.0, 60.0), strict=True))
        _, distance, speed, ramp = max((travel_time(b - a, v, r), b - a, v, r) for a, b, v, r in pairs)
        share = travelled(distance, speed, ramp, at - self._began)
        theta, phi = (a + (b - a) * share for a, b, _, _ in pairs)
        return theta, phi

    # -- the port --------------------------------------------------------------------------------------

    def readline(self) -> bytes:
        """Return a line, in two halves now and then, as a real port does."""
        if self.fails:
            raise OSError("device reports readiness to read but returned no data")
        if not self._out:
            self.sleep(0.05)
        if not self._out:
            return b""
        line = self._out.popleft()
        if len(line) > 20:
            self._out.appendleft(line[20:])
            return line[:20]
        return line

    def write(self, data: bytes) -> int:
        if self.fails:
            raise OSError("write failed")
        for byte in data:
            match chr(byte):
                case "?":
                    theta, phi = self._where()
                    name = "Hold:0" if self._state == "Hold" else self._state
                    self._say(f"<{name}|MPos:{theta:.3f},{phi:.3f},0.000|FS:0,0>")
                case "!":
                    if self._state == "Run":
                        self._hold_at = self.clock + 0.5
                case "\x18":
                    self._reset()
                case "\n":
                    self._line(self._in.decode().strip())
                    self._in = b""
                case other:
                    self._in += other.encode()
        return len(data)

    def close(self) -> None:
        self.closed = True

    def _say(self, *lines: str) -> None:
        self._out.extend(line.encode() + b"\r\n" for line in lines)

    def _reset(self) -> None:
        lost = self._state == "Run" or self._state == "Home"
        self._from = self._to = self._where()
        self._state = "Alarm" if lost or self._state == "Alarm" else "Idle"
        self._dead, self._hold_at, self._feed, self._in = False, None, 0, b""
        self._say("", "Grbl 1.1h ['$' for help]")

    def _line(self, line: str) -> None:
        if self._dead:
            return
        if line:
            self.lines.append(line)
        if line == "$$":
            self._say(*(f"${key}={value}" for key, value in SETTINGS.items()), "ok")
        elif line == "$G":
            self._say(f"[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F{self._feed} S0]", "ok")
        elif line == "$H":
            self._state, self._to, self._until = "Home", (0.0, 0.0), self.clock + HOMING_S
            self._pending.append((self._until, b"ok\r\n"))
        elif line and self._state == "Alarm":
            self._say("error:9")
        elif line.startswith("F"):
            self._feed = int(line[1:])
            self._say("ok")
        elif line.startswith("G21 G90 G53 G0 X"):
            theta, phi = (float(word[1:]) for word in line.split()[4:])
            self._go(theta + self.off_target, phi)
        elif line:
            self._say("error:20")
        else:
            self._say("ok")

    def _go(self, theta: float, phi: float) -> None:
        self._from, self._to, self._began, self._state = self._where(), (theta, phi), self.clock, "Run"
        ways = zip(self._from, self._to, (10.0, 30.0), (20.0, 60.0), strict=True)
        self._until = self.clock + max(travel_time(b - a, speed, ramp) for a, b, speed, ramp in ways)
        self._say("ok")
