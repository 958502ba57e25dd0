"""The example for a microcontroller, compiled on the host with stubs of its SDK, and run on a bench of simulated pins.

That it builds with the real SDK is not shown here: the stubs hold the calls to names and types, as we know them.
"""

import ctypes
import shutil
import struct
from pathlib import Path

import pytest
from c_rig import FIRMWARE, compile_c

from kinran.rig.protocol import (
    Config,
    Expose,
    Fault,
    Ident,
    JobState,
    Move,
    Opcode,
    Report,
    ReportId,
    State,
    Status,
    descriptor,
)

EXAMPLE = FIRMWARE / "examples" / "tinyusb_rp2040"
BENCH = Path(__file__).parent / "pico"
HEADERS = ("tusb.h", *(f"pico/{name}.h" for name in ("stdlib", "rand", "unique_id")))
HEADERS += tuple(f"hardware/{name}.h" for name in ("adc", "flash", "gpio", "sync", "watchdog"))
OUTPUT, FEATURE = 2, 3
LAMP, SHUTTER, RELEASE = 16, 17, 18


@pytest.fixture(scope="module")
def stubs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Headers of the SDK, each of which is the stub."""
    folder = tmp_path_factory.mktemp("pico")
    for name in HEADERS:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text('#include "pico_stub.h"\n')
    return folder


def includes(stubs: Path) -> list[str]:
    return [f"-I{folder}" for folder in (stubs, BENCH, EXAMPLE)]


@pytest.mark.parametrize("name", ["main.c", "usb_descriptors.c"])
def test_it_compiles_strictly(name: str, stubs: Path) -> None:
    compile_c("-fsyntax-only", *includes(stubs), str(EXAMPLE / name))


class Pico:
    """The example on its bench, spoken to as TinyUSB does."""

    def __init__(self, library: Path) -> None:
        self.c = ctypes.CDLL(str(library))
        self.c.tud_hid_descriptor_report_cb.restype = ctypes.POINTER(ctypes.c_uint8)
        self.c.tud_descriptor_configuration_cb.restype = ctypes.POINTER(ctypes.c_uint8)
        self.c.tud_hid_get_report_cb.restype = ctypes.c_uint16
        self.c.bench_read.restype = self.c.bench_pin.restype = ctypes.c_bool
        self.c.bench_start()
        self.seq = 0
        self.boot = 0
        self.boot = self.send(Opcode.HELLO, bytes(4)).boot

    def send(self, opcode: Opcode, payload: bytes = b"") -> Report:
        self.seq += 1
        data = Report(ReportId.COMMAND, self.seq, opcode, boot=self.boot, payload=payload).pack()
        self.c.tud_hid_set_report_cb(0, 0, OUTPUT, data, len(data))
        self.c.bench_advance(20)
        report = ctypes.create_string_buffer(64)
        replies = []
        while self.c.bench_read(report):
            replies.append(Report.unpack(report.raw))
        (reply,) = (reply for reply in replies if reply.id == ReportId.REPLY)
        assert reply.seq == self.seq
        return reply

    def feature(self, id_: ReportId) -> Report:
        data = ctypes.create_string_buffer(63)
        assert self.c.tud_hid_get_report_cb(0, id_, FEATURE, data, 63) == 63
        return Report.unpack(bytes([id_]) + data.raw)

    def state(self) -> State:
        return State.unpack(self.feature(ReportId.STATUS).payload)

    def wait(self, seconds: float) -> None:
        """Let time pass, and drop the events."""
        for _ in range(round(seconds)):
            self.c.bench_advance(1000)
            while self.c.bench_read(ctypes.create_string_buffer(64)):
                pass


@pytest.fixture(scope="module")
def compiled(stubs: Path) -> Path:
    """The example and its bench."""
    library = stubs / "pico.so"
    sources = (BENCH / "bench.c", EXAMPLE / "usb_descriptors.c", FIRMWARE / "kinran_rig.c")
    compile_c("-O1", "-fPIC", "-shared", *includes(stubs), *map(str, sources), "-lm", "-o", str(library))
    return library


@pytest.fixture
def pico(compiled: Path, tmp_path: Path) -> Pico:
    """A Pico of its own, whose host needs no watchdog."""
    pico = Pico(Path(shutil.copy(compiled, tmp_path / "pico.so")))
    pico.send(Opcode.WATCHDOG, bytes(4))
    return pico


def test_it_declares_the_reports_of_the_protocol(pico: Pico) -> None:
    text = descriptor()
    assert bytes(pico.c.tud_hid_descriptor_report_cb(0)[: len(text)]) == text
    configuration = bytes(pico.c.tud_descriptor_configuration_cb(0)[:41])
    assert struct.unpack_from("<H", configuration, 2)[0] == 41
    assert struct.unpack_from("<H", configuration, 25)[0] == len(text)
    assert Ident.unpack(pico.feature(ReportId.IDENT).payload).serial == "E66118604B2C5B2A"
    assert pico.c.tud_hid_get_report_cb(0, 0x55, FEATURE, ctypes.create_string_buffer(63), 63) == 0


def test_it_homes_and_its_arms_go_where_they_should(pico: Pico) -> None:
    """The arms of the bench turn by the step pulses alone, and only they know where they really stand."""
    pico.send(Opcode.HOME, b"\x0f")
    pico.wait(38)
    assert pico.state().homed == 15
    pico.send(Opcode.MOVE, Move(3, (35_000, 120_000, 0, 0), settle_ms=100).pack())
    pico.wait(2)
    assert pico.state().moving == 3
    pico.wait(6)
    assert pico.state().job_state == JobState.DONE
    assert [pico.c.bench_arm(axis) for axis in (0, 1)] == pytest.approx([35_000, 120_000], abs=20)
    assert pico.state().position[:2] == pytest.approx((35_000, 120_000), abs=20)
    assert pico.send(Opcode.MOVE, Move(1, (95_000, 0, 0, 0)).pack()).code == Status.LIMIT
    pico.send(Opcode.MOVE, Move(1, (80_000, 0, 0, 0)).pack())
    pico.wait(2)
    pico.c.tud_hid_set_report_cb(0, 0, OUTPUT, b"\x0f", 1)
    stopped = pico.c.bench_arm(0)
    pico.wait(1)
    assert pico.c.bench_arm(0) == stopped


def test_an_emergency_stop_ends_the_search_for_the_references(pico: Pico) -> None:
    pico.send(Opcode.HOME, b"\x0f")
    pico.wait(1)
    begun = pico.c.bench_arm(0)
    assert begun < 19_000
    pico.c.tud_hid_set_report_cb(0, ReportId.ESTOP, OUTPUT, bytes(63), 63)
    stopped = pico.c.bench_arm(0)
    pico.wait(2)
    assert pico.c.bench_arm(0) == stopped
    assert pico.state().fault == Fault.ESTOP


def test_its_lamp_shutter_and_camera(pico: Pico) -> None:
    pico.send(Opcode.LAMP, b"\1")
    pico.send(Opcode.SHUTTER, struct.pack("<BI", 1, 2000))
    assert pico.c.bench_pin(LAMP)
    assert pico.c.bench_pin(SHUTTER)
    pico.send(Opcode.EXPOSE, Expose((100_000, 50_000), 50).pack())
    assert pico.c.bench_pin(RELEASE)
    pico.wait(1)
    assert not pico.c.bench_pin(RELEASE)
    assert (pico.state().batch, pico.state().exposures) == (2, 2)
    pico.wait(1)
    assert not pico.c.bench_pin(SHUTTER)
    assert pico.state().photodiode == 3000


def test_it_keeps_its_configuration_in_the_flash(pico: Pico) -> None:
    config = Config.unpack(pico.feature(ReportId.CONFIG).payload)
    narrow = Config(config.low, (45_000, *config.high[1:]), config.speeds, config.accelerations, 1000, 90)
    data = Report(ReportId.CONFIG, payload=narrow.pack()).pack()
    pico.c.tud_hid_set_report_cb(0, ReportId.CONFIG, FEATURE, data[1:], 63)
    pico.c.bench_start()
    assert Config.unpack(pico.feature(ReportId.CONFIG).payload) == narrow
