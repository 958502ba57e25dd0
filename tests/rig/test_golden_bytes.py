"""The bytes of docs/rig.md: what the library packs and unpacks, and what both firmwares answer."""

import ctypes
import re
from pathlib import Path

from c_rig import CDevice
from rig_conformance import Device, PythonDevice

from kinran.rig.firmware import Firmware
from kinran.rig.protocol import (
    Config,
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
    estop_report,
)

PAGE = Path(__file__).parents[2] / "docs" / "rig.md"
BOOT = 0x1234ABCD
SEED = 4241276070
"""Seed of the simulated rig in C whose first random number is the boot id of the page."""


def golden() -> list[tuple[str, str, bytes]]:
    """Who says it, what it is, and its bytes, in the order of the page."""
    section = PAGE.read_text(encoding="utf-8").partition("### Golden bytes")[2]
    block = section.split("```")[1]
    found = re.findall(r"^(\w+): (.+)\n((?: +[0-9a-f ]+\n)+)", block, re.MULTILINE)
    return [(who, what, bytes.fromhex(data)) for who, what, data in found]


def test_every_kind_of_report_is_there() -> None:
    ids = {data[0] for who, _, data in golden() if who != "descriptor"}
    assert ids == set(ReportId)
    assert {len(data) for who, _, data in golden() if who != "descriptor"} == {64}


def test_the_library_packs_and_unpacks_them() -> None:
    said = {what.split(",")[0]: data for _, what, data in golden()}
    command = ReportId.COMMAND
    move = Move(3, (35_000, 120_000, 0, 0), settle_ms=200)
    assert said["HELLO"] == Report(command, 1, Opcode.HELLO, payload=b"\1\2\3\4").pack()
    assert said["MOVE"] == Report(command, 2, Opcode.MOVE, boot=BOOT, payload=move.pack()).pack()
    assert said["ESTOP"] == estop_report()
    assert said["the report descriptor"] == descriptor()
    assert Report.unpack(said["REPLY NOT_HOMED"]).code == Status.NOT_HOMED
    ident = Ident.unpack(Report.unpack(said["IDENT"]).payload)
    assert ident == Ident(1, "OGM-SIMULATED", capabilities=1, reset_cause=0, major=1, minor=1)
    assert Config.unpack(Report.unpack(said["CONFIG"]).payload).homing_s == 5
    assert State.unpack(Report.unpack(said["STATUS"]).payload).moving == 15
    event = State.unpack(Report.unpack(said["EVENT 1"]).payload)
    assert (event.fault, event.job_state, event.event) == (Fault.ESTOP, JobState.FAULTED, 1)


def converse(device: Device) -> None:
    """Say what the host says, and compare what the rig answers."""
    answers: list[bytes] = []
    for who, what, data in golden():
        if who == "host":
            assert answers == []
            device.write(data)
            answers = device.read(1)
        elif who == "rig":
            assert answers.pop(0).hex(" ") == data.hex(" "), what
        elif who == "feature":
            answer = device.get_feature(data[0])
            assert answer is not None
            assert answer.hex(" ") == data.hex(" "), what
    assert answers == []


def test_the_simulated_firmware_says_them() -> None:
    firmware = Firmware(serial="OGM-SIMULATED")
    firmware.boot = BOOT
    converse(PythonDevice(firmware))


def test_the_firmware_in_c_says_them(c_rig: ctypes.CDLL) -> None:
    device = CDevice(c_rig, SEED)
    converse(device)
    assert device.descriptor() == golden()[-1][2]
