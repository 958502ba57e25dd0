"""Checks of the driver and of the command line on a kernel: what runs in the guest.

``rig_guest.py SETUP …`` prints a line for each check, and ends with their numbers. A check that something is
refused asks for the sentence that a user reads.
"""

import gc
import os
import signal
import stat
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from emulated_rig import HOMING_S, PRODUCT_NAME, SERIAL, quicker
from guest_bench import Bench, Program, User, close_to, load_commands, raised, udevadm
from kernel_device import KernelDevice, conforms
from rig_scenarios import SCENARIOS

from kinran.capture.rig import udev_rule
from kinran.rig.errors import (
    DisconnectedError,
    FaultError,
    LimitError,
    RebootedError,
    RefusedError,
    RigError,
    RigTimeoutError,
)
from kinran.rig.goniometer import ALL_AXES
from kinran.rig.hid_goniometer import HidGoniometer
from kinran.rig.motion import AXES
from kinran.rig.opening import RigSettings, open_goniometer
from kinran.rig.protocol import REPORT, Config, Flag, Ident, Opcode, Report, ReportId, State, descriptor
from kinran.rig.transport import PRODUCT, UDEV_RULE, VENDOR, TransportError, hid_module, open_hid

RULES = Path("/run/udev/rules.d")
"""Folder of rules of udev that can be written to in the guest."""
MEMBER, STRANGER = User(("plugdev",)), User()
"""Nobody, in the group that the rule names and outside it."""
HELD_S = 3.0
"""Seconds for which the host is busy with a camera: more than the 2 s of the watchdog."""
BUSY = ("another program",), ("cannot be opened",)
"""What the second program reads, through hidraw and through libusb, whose claim is the lock."""
QUEUE = 63
"""Reports that hidraw keeps for a host that reads none."""
FLOOD = 200
"""Events that no host reads: more than either back-end keeps."""


def driver() -> Any:
    """Open the rig as the product does."""
    return open_goniometer("hid", RigSettings())


def ready(rig: HidGoniometer) -> None:
    """Greet and home a rig."""
    rig.hello()
    rig.home()


def check_handle(bench: Bench) -> None:
    """What `SimulatedHid` and the driver take for granted of hidapi and of the kernel."""
    hidraw = bench.backend == "hidraw"
    found = hid_module().enumerate(VENDOR, PRODUCT)
    bench.check("one rig is listed", len(found) == 1 and found[0]["serial_number"] == SERIAL, found)
    usage = found[0]["usage_page"], found[0]["usage"]
    bench.check("the usage is listed by hidraw alone", usage == ((0xFF4B, 1) if hidraw else (0, 0)), usage)
    opened = open_hid()
    handle: Any = opened.handle
    names = handle.get_product_string(), handle.get_serial_number_string()
    bench.check("names and serial number are read", names == (PRODUCT_NAME, SERIAL), names)
    described = bytes(handle.get_report_descriptor())
    bench.check("the report descriptor arrives", described == descriptor(), described.hex())
    for feature, kind in ((ReportId.STATUS, State), (ReportId.IDENT, Ident), (ReportId.CONFIG, Config)):
        report = Report.unpack(bytes(handle.get_feature_report(feature, REPORT)))
        bench.check(f"the feature {feature.name} arrives whole", kind.unpack(report.payload), report.payload.hex())
    config = Config.unpack(report.payload)
    narrower = Config((1000, *config.low[1:]), config.high, config.speeds, config.accelerations, 1500, 7)
    sent = handle.send_feature_report(Report(ReportId.CONFIG, payload=narrower.pack()).pack())
    read = Config.unpack(Report.unpack(bytes(handle.get_feature_report(ReportId.CONFIG, REPORT))).payload)
    bench.check("a configuration is written and read back", sent == REPORT and read == narrower, read)
    handle.send_feature_report(Report(ReportId.CONFIG, payload=config.pack()).pack())
    sent = handle.send_feature_report(Report(ReportId.CONFIG, payload=config.pack()).pack()[:-1] + b"\0")
    bench.check("a refused feature is -1, and no exception", sent == -1, sent)
    error = raised(lambda: handle.get_feature_report(0x55, REPORT), OSError)
    bench.check("an unknown feature is an error", error, error)
    nop = Report(ReportId.COMMAND, 1, Opcode.NOP).pack()
    while handle.read(REPORT, 20):
        pass
    sent = handle.write(nop)
    while (reply := bytes(handle.read(REPORT, 1000)))[:1] == bytes([ReportId.EVENT]):
        pass
    bench.check("a command is answered", sent == REPORT and Report.unpack(reply).id == ReportId.REPLY, reply.hex())
    handle.read(REPORT, 2000)  # an event; the next comes after a second
    before = time.monotonic()
    nothing = handle.read(REPORT, 100)
    bench.check("a read that times out is empty", nothing == [] and time.monotonic() - before > 0.09, nothing)
    for data in (b"", b"\x01"):
        sent = handle.write(data)
        wanted = len(data) if data and not hidraw else -1
        bench.check(f"a command of {len(data)} bytes is {wanted}", sent == wanted, sent)
    while handle.read(REPORT, 100):
        pass
    bench.rig("raw " + bytes([ReportId.EVENT, *range(1, REPORT)]).hex())
    part = handle.read(16, 1000)
    rest = handle.read(REPORT, 50)
    bench.check("the rest of a report that is read in part is lost", len(part) == 16 and rest == [], (part, rest))
    bench.rig("raw " + (b"\x44" + bytes(REPORT - 1)).hex())
    undeclared = handle.read(REPORT, 200)
    bench.check("hidraw alone drops an undeclared report", bool(undeclared) != hidraw, len(undeclared))
    numbers = overflow(bench, handle)
    last = bench.rig().events
    kept = numbers[0] < last - FLOOD + 9 if hidraw else numbers[-1] > last - 9  # the rig sends others by itself
    bench.check(f"of {FLOOD} unread events few are kept, by hidraw the oldest", kept and len(numbers) <= 64, numbers)
    handle.close()
    error = raised(lambda: handle.read(REPORT, 20), ValueError)
    bench.check("a closed handle says so", error, error)
    if hidraw and bench.link == "uhid":
        import hid

        bench.check("libusb does not see a device of uhid", hid.enumerate(VENDOR, PRODUCT) == [])


def overflow(bench: Bench, handle: Any) -> list[int]:
    """Return the numbers of the events that are left of many that nobody read."""
    bench.rig(f"events {FLOOD}")
    time.sleep(1.0 if bench.link == "vhci" else 0.1)
    numbers = []
    while data := handle.read(REPORT, 100):
        numbers.append(State.unpack(Report.unpack(bytes(data)).payload).event)
    return numbers


def check_driver(bench: Bench) -> None:
    """The driver's methods."""
    with driver() as rig:
        before = bench.rig()
        rig.look()
        after = bench.rig()
        same = (before.flags, before.job, before.fault) == (after.flags, after.job, after.fault)
        bench.check("a look changes nothing", same and rig.identity.serial == SERIAL, (before, after))
        rig.hello()
        identity = rig.identity
        bench.check("hello reads the boot id", rig.boot == identity.boot == bench.rig().boot, rig.boot)
        speeds = [axis.speed for axis in identity.axes]
        bench.check("speeds are the rig's own", speeds == [axis.speed for axis in quicker(AXES)], speeds)
        bench.check("so is the time of homing", HOMING_S <= identity.homing_s <= HOMING_S + 1, identity.homing_s)
        bench.check("hello sets the watchdog", rig.status().has(Flag.WATCHDOG), rig.state)
        error = raised(lambda: rig.move(1000, 0), RefusedError)
        bench.check("a move before homing is refused", "NOT_HOMED" in str(error), error)
        rig.home()
        bench.check("all axes are homed", bench.rig().homed == ALL_AXES == rig.state.homed, rig.state)
        state = rig.move(20_000, 30_000)
        there = bench.rig().pose
        bench.check("the arm is where it was sent", close_to(there, (20_000, 30_000)), there)
        bench.check("the encoders are what is returned", close_to(state.position, there), state.position)
        rig.move(20_000, 30_000, (10_000, -10_000))
        there = bench.rig().pose
        bench.check("the camera arm moves, too", close_to(there, (20_000, 30_000, 10_000, -10_000)), there)
        rig.move(20_000, 30_000, (0, 0))
        moves = bench.rig().moves
        error = raised(lambda: rig.move(95_000, 0), LimitError)
        bench.check("a pose outside the limits is not sent", error and bench.rig().moves == moves, error)
        rig.lamp(True)
        rig.wait(5.0)
        bench.check("the lamp burns and becomes warm", rig.status().has(Flag.LAMP_WARM) and bench.rig().lamp)
        counts = rig.intensity()
        bench.check("the photodiode measures the lamp", 50_000 < counts < 150_000, counts)
        rig.shutter(True, 30)
        bench.check("the shutter opens", bench.rig().shutter)
        time.sleep(HELD_S)
        truth = bench.rig()
        bench.check("the watchdog is fed while the host is busy", truth.shutter and truth.fault == "NONE", truth)
        rig.shutter(False)
        bench.check("the shutter closes", not bench.rig().shutter)
        before = bench.rig().exposures
        rig.release((0.01, 0.02), 0.01)
        bench.check("released exposures are counted", rig.status().exposures == before + 2, rig.state.exposures)
        rig.shutter(True, 30)
    truth = bench.rig()
    bench.check("closing the driver closes the shutter", not truth.shutter and truth.lamp, truth)


def check_line(bench: Bench) -> None:
    """A bad line between host and rig."""
    with driver() as rig:
        ready(rig)
        for number, kind in enumerate(("drop_command", "drop_reply", "dup_reply", "late_reply", "corrupt"), 1):
            moves = bench.rig(f"inject {kind}").moves
            rig.move(2000 * number, 0)
            truth = bench.rig()
            once = truth.moves == moves + 1 and close_to(truth.pose, (2000 * number, 0))
            bench.check(f"with {kind} a move is made once", once, (truth.moves - moves, rig.retries))
        moves = bench.rig("inject off_target").moves
        rig.move(1000, 0)
        bench.check("an arm that rests off its target is moved again", bench.rig().moves == moves + 2)
        ticks = []
        signal.signal(signal.SIGALRM, lambda number, frame: ticks.append(number))
        signal.setitimer(signal.ITIMER_REAL, 0.03, 0.03)
        try:
            error = raised(lambda: rig.move(20_000, 0), RigError)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
        bench.check("signals during a move are no disconnect", error is None and len(ticks) > 5, (error, len(ticks)))
        bench.rig(f"events {QUEUE}")
        rig.move(10_000, 0)
        bench.check("a full queue is no harm", close_to(bench.rig().pose, (10_000, 0)))
        if bench.link == "vhci":
            bench.rig("refuse")
            error = raised(rig.ping, DisconnectedError)
            again = raised(rig.ping, RigError)
            bench.check("after a STALL of USB the next command works", error and again is None, (error, again))
        error = raised(lambda: bench.rig("mute") and rig.status(), DisconnectedError)
        bench.check("a feature that is not answered is a disconnect", "cable" in str(error), error)
        rig.ping()
        bench.rig("inject hang")
        error = raised(rig.ping, RigTimeoutError, DisconnectedError)
        bench.check("a firmware that hangs is named", "off and on" in str(error), error)
    bench.rig("reboot")
    with driver() as rig:
        bench.check("after it is switched off and on it works", raised(lambda: ready(rig), RigError) is None)


def check_faults(bench: Bench) -> None:
    """Faults that the rig latches, and a restart."""
    with driver() as rig:
        ready(rig)
        bench.rig("inject stall")
        error = raised(lambda: rig.move(30_000, 0), FaultError)
        bench.check("a stall names its axis", "STALL on axis 0" in str(error), error)
        bench.check("the arm stands on the way", 0 < bench.rig().pose[0] < 30_000 and bench.still())
        error = raised(lambda: rig.move(0, 0), FaultError)
        bench.check("until it is cleared nothing moves", "STALL" in str(error), error)
        rig.clear()
        rig.move(0, 0)
        bench.check("cleared, the arm moves", close_to(bench.rig().pose, (0, 0)))
        rig.shutter(True, 30)
        rig.estop()
        truth = bench.until(lambda truth: truth.fault == "ESTOP")
        bench.check("the emergency stop closes the shutter", truth.fault == "ESTOP" and not truth.shutter, truth)
        rig.status()
        rig.clear()
        bench.rig("happen door_open 0")
        error = raised(lambda: rig.move(5000, 0), RigError)
        bench.check("with an open door nothing moves", "INTERLOCK" in str(error), error)
        bench.rig("happen door_closed 0")
        rig.status()
        rig.clear()
        rig.move(5000, 0)
        bench.check("with the door closed it does", close_to(bench.rig().pose, (5000, 0)))
        bench.rig("inject reboot")
        moves = bench.rig().moves
        error = raised(lambda: rig.move(10_000, 0), RebootedError)
        bench.check("a restart is named", error, error)
        bench.check("and nothing is repeated after it", bench.rig().moves == moves and not bench.rig().homed)
        ready(rig)
        rig.move(10_000, 0)
        bench.check("greeted and homed, the rig works", close_to(bench.rig().pose, (10_000, 0)))


def check_cable(bench: Bench) -> None:
    """The cable is pulled, and the rig's power fails."""
    with driver() as rig:
        ready(rig)
        boot = rig.boot
        bench.rig("inject unplug")
        error = raised(lambda: rig.move(30_000, 0), DisconnectedError)
        bench.check("a cable that is pulled at a command is a disconnect", "cable" in str(error), error)
    bench.seen(False)
    gone = hid_module().enumerate(VENDOR, PRODUCT)
    bench.check("the rig is not listed any more", gone == [], gone)
    error = raised(lambda: driver().__enter__(), TransportError)
    bench.check("no rig is named with its pair", "1209:0001" in str(error) and "cable" in str(error), error)
    bench.rig("plug")
    bench.seen(True)
    with driver() as rig:
        rig.hello()
        bench.check("plugged in again, it is the same boot", rig.boot == boot, (rig.boot, boot))
        rig.home()
        pulled = pull_while_moving(bench, rig, lambda: bench.rig("unplug"))
        bench.check("a cable that is pulled in a move is a disconnect", "disconnected" in str(pulled), pulled)
    error = raised(lambda: rig.ping(), ValueError, RigError)
    bench.check("a driver that was closed stays closed", error, error)
    bench.rig("plug")
    bench.seen(True)
    with driver() as rig:
        ready(rig)
        killed = pull_while_moving(bench, rig, bench.rig.kill)
        bench.check("power that fails in a move is a disconnect", "disconnected" in str(killed), killed)
    bench.restarted()
    with driver() as rig:
        rig.hello()
        bench.check("after it the rig has forgotten its pose", rig.boot != boot and not rig.state.homed, rig.state)


def pull_while_moving(bench: Bench, rig: HidGoniometer, pull: Callable[[], object]) -> Exception | None:
    """Do something to the rig half a second after a move began, and return the error of the move."""

    def at(number: int, frame: object) -> None:
        pull()

    signal.signal(signal.SIGALRM, at)
    signal.setitimer(signal.ITIMER_REAL, 0.5)
    return raised(lambda: rig.move(0, 300_000), DisconnectedError)


def lit() -> int:
    """Light the lamp: a program."""
    with driver() as rig:
        rig.hello()
        rig.lamp(True)
    return 0


def check_commands(bench: Bench) -> None:
    """``kinran rig``, as a user calls it."""
    before = bench.rig()
    ended = bench.kinran("status").wait()
    after = bench.rig()
    bench.check("status shows serial number and state", ended.status == 0 and SERIAL in ended.out, ended)
    same = (before.flags, before.job, before.boot) == (after.flags, after.job, after.boot)
    bench.check("status only looks", same, (before, after))
    ended = bench.kinran("--serial", "NO-SUCH", "status").wait()
    bench.check("another serial number is refused with both", ended.refused("NO-SUCH", SERIAL), ended)
    ended = bench.kinran("--usb", "1209:0002", "status").wait()
    bench.check("another pair is refused with its name", ended.refused("1209:0002"), ended)
    ended = bench.kinran("--usb", "rig", "status").wait()
    bench.check("what is no pair is refused", ended.refused("VENDOR:PRODUCT"), ended)
    ended = bench.kinran("move", "10", "20").wait()
    bench.check("a move before homing is refused", ended.refused("NOT_HOMED"), ended)
    ended = bench.kinran("jog", "theta", "1").wait()
    bench.check("so is a jog", ended.refused("kinran rig home"), ended)
    ended = bench.kinran("home").wait()
    bench.check("home finds all references", ended.status == 0 and bench.rig().homed == ALL_AXES, ended)
    ended = bench.kinran("move", "10", "20").wait()
    bench.check("move moves", ended.status == 0 and close_to(bench.rig().pose, (10_000, 20_000)), ended)
    ended = bench.kinran("move", "95", "0").wait()
    there = bench.rig().pose
    bench.check("a direction outside is refused", ended.refused("95°") and close_to(there, (10_000, 20_000)), ended)
    ended = bench.kinran("jog", "theta", "-2.5").wait()
    bench.check("jog moves one axis", ended.status == 0 and close_to(bench.rig().pose, (7500, 20_000)), ended)
    bench.rig("trip STALL 1")
    ended = bench.kinran("status").wait()
    bench.check("status shows a fault", ended.status == 0 and "stall" in ended.out, ended)
    bench.check("and leaves it", bench.rig().fault == "STALL")
    ended = bench.kinran("move", "0", "0").wait()
    bench.check("with a fault a move is refused", ended.refused("STALL on axis 1", "kinran rig home"), ended)
    ended = bench.kinran("home").wait()
    shown = "stall" in ended.out and bench.rig().fault == "NONE"
    bench.check("home shows the fault and clears it", ended.status == 0 and shown, ended)
    Program(lit).wait()
    lamp = bench.rig().lamp
    ended = bench.kinran("park").wait()
    truth = bench.rig()
    bench.check(
        "park moves to θ = 0 and puts out the lamp", close_to(truth.pose, (0, 0)) and lamp and not truth.lamp, ended
    )
    bench.rig("inject hang")
    ended = bench.kinran("move", "5", "5").wait()
    bench.check("a firmware that hangs is a sentence", ended.refused("off and on"), ended)
    bench.rig("reboot")


def check_two_programs(bench: Bench) -> None:
    """Two programs that would drive the rig."""
    busy = BUSY[bench.backend == "libusb"]
    bench.kinran("home").wait()
    first = bench.kinran("move", "0", "300")
    bench.until(lambda truth: truth.running)
    elsewhere = {"XDG_RUNTIME_DIR": "/run/other", "TMPDIR": "/run/other"}
    for who, words, environment in (
        ("a second program", "status", {}),
        ("one with other folders of its own", "status", elsewhere),
        ("one that would move", "home", elsewhere),
    ):
        ended = bench.kinran(words, **environment).wait()
        bench.check(f"{who} is refused", ended.refused(*busy), ended)
    if bench.backend == "hidraw":
        bench.check("the first is named with its number", f"process {first.pid}" in ended.error, ended.error)
    moving = bench.rig().running
    ended = first.wait()
    there = bench.rig().pose
    undisturbed = ended.status == 0 and close_to(there, (0, 300_000)) and moving
    bench.check("the first is not disturbed", undisturbed, (moving, there, ended))
    ended = bench.kinran("status").wait()
    bench.check("after its end the second is let in", ended.status == 0, ended)
    first = bench.kinran("move", "0", "0")
    bench.until(lambda truth: truth.running)
    second = bench.kinran("estop").wait()
    if bench.backend == "libusb":
        bench.check("an emergency stop meets the claim, and says so", second.refused(*busy), second)
        first.signal(signal.SIGTERM)
        ended = first.wait()
        bench.check("ending the first stops the arm", bench.still() and ended.status == 130, ended)
        return
    truth = bench.until(lambda truth: truth.fault == "ESTOP", 5)
    bench.check("an emergency stop of a second program stops the arm", second.status == 0 and bench.still(), second)
    bench.check("and is latched", truth.fault == "ESTOP", truth)
    ended = first.wait()
    bench.check("the first program says why it stopped", ended.refused("ESTOP"), ended)


def check_ends_of_a_host(bench: Bench) -> None:
    """The host is interrupted, ended, or killed."""
    bench.kinran("home").wait()
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        program = moving(bench)
        program.signal(signal.Signals[name])
        ended = program.wait()
        there = bench.rig()
        found = (ended, there)
        bench.check(f"{name} in a move stops the arm", bench.still() and there.fault == "NONE", found)
        bench.check(f"{name} is told in a line", ended.status == 130 and ended.error.count("\n") == 0, ended)
    program = moving(bench)
    program.signal(signal.SIGINT)
    time.sleep(0.02)
    program.signal(signal.SIGINT)
    program.wait()
    bench.check("Ctrl-C twice stops the arm as well", bench.still() and bench.rig().fault == "NONE")
    program = moving(bench)
    program.signal(signal.SIGKILL)
    program.wait()
    truth = bench.until(lambda truth: not truth.running, 5)
    bench.check("after kill -9 the watchdog stops the arm", truth.fault == "WATCHDOG" and bench.still(), truth)
    ended = bench.kinran("status").wait()
    shown = "watchdog" in ended.out and bench.rig().fault == "WATCHDOG"
    bench.check("status shows that and leaves it", ended.status == 0 and shown, ended)
    ended = bench.kinran("jog", "theta", "1").wait()
    bench.check("the next command clears it", ended.status == 0 and bench.rig().fault == "NONE", ended)
    program = moving(bench)
    program.signal(signal.SIGSTOP)
    truth = bench.until(lambda truth: not truth.running, 5)
    bench.check("so does the watchdog if the host is frozen", truth.fault == "WATCHDOG", truth)
    program.signal(signal.SIGCONT)
    ended = program.wait()
    bench.check("thawed, the host says so", ended.refused("WATCHDOG"), ended)

    def expose() -> int:
        with driver() as rig:
            rig.hello()
            rig.lamp(True)
            rig.shutter(True, 30)
            time.sleep(60)
        return 0

    program = Program(expose)
    bench.until(lambda truth: truth.shutter)
    time.sleep(HELD_S)
    alive = bench.rig().shutter
    program.signal(signal.SIGKILL)
    program.wait()
    truth = bench.until(lambda truth: not truth.shutter, 5)
    closed = alive and not truth.shutter and truth.fault == "WATCHDOG"
    bench.check("after kill -9 in an exposure the shutter is closed", closed, truth)
    bench.check("and the lamp stays lit", truth.lamp, truth)
    for word, wanted in (("reboot", "restarted"), ("unplug", "disconnected")):
        program = moving(bench)
        bench.rig(word)
        ended = program.wait()
        bench.check(f"{word} in a move of the command is a sentence", ended.refused(wanted), ended)


def moving(bench: Bench) -> Program:
    """Start a move that takes over six seconds, and return its program once the arm moves."""
    if bench.rig().homed != ALL_AXES:
        bench.kinran("home").wait()
    far = "360" if bench.rig().pose[1] < 180_000 else "0"
    program = bench.kinran("move", "0", far)
    bench.until(lambda truth: truth.running)
    time.sleep(0.2)
    return program


def check_permissions(bench: Bench) -> None:
    """The rule of udev that ``kinran rig install-udev`` writes."""
    rule = RULES / UDEV_RULE
    rule.unlink(missing_ok=True)
    replug(bench)
    for who, user in (("a user", MEMBER), ("a stranger", STRANGER)):
        ended = bench.kinran("status", user=user).wait()
        bench.check(f"without the rule {who} is sent to it", ended.refused("install-udev"), ended)
    ended = bench.kinran("install-udev", "--to", str(RULES), user=MEMBER).wait()
    bench.check("whoever may not write it is told how", ended.refused("sudo", str(rule)), ended)
    bench.kinran("--usb", "1209:0002", "install-udev", "--to", str(RULES)).wait()
    replug(bench)
    ended = bench.kinran("status", user=MEMBER).wait()
    bench.check("the rule of another rig does not help", ended.refused("install-udev"), ended)
    ended = bench.kinran("install-udev", "--to", str(RULES)).wait()
    written = rule.read_text() == udev_rule(RigSettings.usb)
    bench.check("the rule is written, with what comes next", ended.status == 0 and written, ended)
    bench.check("it can be read by all", stat.S_IMODE(rule.stat().st_mode) == 0o644, oct(rule.stat().st_mode))
    replug(bench)
    nodes = [
        path for path in (*Path("/dev").glob("hidraw*"), *Path("/dev/bus/usb").rglob("*")) if path.is_char_device()
    ]
    modes = {str(path): f"{stat.S_IMODE(path.stat().st_mode):o} {path.group()}" for path in nodes}
    bench.check("the rig's node belongs to plugdev", "660 plugdev" in modes.values(), modes)
    ended = bench.kinran("status", user=STRANGER).wait()
    bench.check("with the rule a stranger is refused", ended.refused("install-udev"), ended)
    ended = bench.kinran("--serial", SERIAL, "status", user=STRANGER).wait()
    bench.check("a stranger who names the rig is, too", ended.refused("install-udev"), ended)
    ended = bench.kinran("home", user=MEMBER).wait()
    bench.check("with the rule a user homes the rig", ended.status == 0 and bench.rig().homed == ALL_AXES, ended)
    first = bench.kinran("move", "0", "180", user=MEMBER)
    bench.until(lambda truth: truth.running)
    ended = bench.kinran("status").wait()
    busy = BUSY[bench.backend == "libusb"]
    bench.check("while a user drives the rig, root is refused", ended.refused(*busy), ended)
    ended = first.wait()
    bench.check("and the user is not disturbed", ended.status == 0, ended)


def replug(bench: Bench) -> None:
    """Let udev read its rules, and plug the rig in anew."""
    udevadm("control", "--reload")
    bench.rig("unplug")
    bench.seen(False)
    bench.rig("plug")
    bench.seen(True)


def check_scenarios(bench: Bench) -> None:
    """The table of scenarios, which the simulated firmware and the one in C are held to as well."""
    handle = open_hid().handle
    for scenario in SCENARIOS:
        found = conforms(scenario, KernelDevice(handle, bench.rig))
        bench.check(f"scenario: {scenario.name}", not found, found)
    handle.close()


DRIVER = (check_handle, check_driver, check_line, check_cable)
"""Checks of what the links and the back-ends do each in their own way."""
CHECKS = {
    "hidraw:uhid": (*DRIVER, check_faults, check_commands, check_two_programs, check_permissions, check_scenarios),
    "hidraw:vhci": (*DRIVER, check_ends_of_a_host),
    "libusb:vhci": (*DRIVER, check_faults, check_two_programs, check_ends_of_a_host, check_permissions),
}
"""Checks in each set-up; each begins with a rig after power-on."""


def run(setup: str, check: Callable[[Bench], None]) -> None:
    """Run some checks in a set-up, with a rig of their own."""
    backend, link = setup.split(":")
    if backend == "libusb":
        sys.modules["hidraw"] = None  # type: ignore[assignment]
    bench = Bench(backend, link)
    began = time.monotonic()
    try:
        check(bench)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[1:]
        lines = ", ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in where)
        bench.check(f"{check.__name__} comes to its end", False, f"{error!r} at {lines}")
    print(f"note {setup} {check.__name__} took {time.monotonic() - began:.1f} s of the guest", flush=True)
    bench.rig.kill()
    bench.seen(False)


def main(setups: Sequence[str]) -> None:
    """Run the set-ups in turn."""
    try:
        hid_module()
    except TransportError as error:
        print(f"@needs hidapi: {error}")
        return
    os.chdir("/run")
    load_commands()
    gc.freeze()  # forks then share the memory of what is loaded, instead of copying it
    for setup in setups:
        ended = [forked(setup, check) for check in CHECKS[setup]]
        if all(ended):
            print(f"@end {setup}", flush=True)


def forked(setup: str, check: Callable[[Bench], None]) -> bool:
    """Run some checks in a fork of this process, and return whether it came to its end."""
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return os.waitpid(pid, 0)[1] == 0
    try:
        run(setup, check)
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])
