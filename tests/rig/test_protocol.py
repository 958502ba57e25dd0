"""The wire protocol, byte by byte."""

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinran.rig.protocol import (
    Config,
    Expose,
    Flag,
    Ident,
    JobState,
    Move,
    Opcode,
    ProtocolError,
    Report,
    ReportId,
    State,
    descriptor,
    estop_report,
)

byte = st.integers(0, 0xFF)
u16 = st.integers(0, 0xFFFF)
u32 = st.integers(0, 0xFFFFFFFF)
i32 = st.integers(-(2**31), 2**31 - 1)

reports = st.builds(Report, byte, u16, byte, byte, byte, u32, st.binary(max_size=48))
states = st.builds(
    State, u32, st.tuples(i32, i32, i32, i32), u16, u16, byte, byte, byte, byte, u32, u32, u16, u16, u32, i32
)


def test_golden_move() -> None:
    """A MOVE to θ = 35°, φ = 120°, written out by hand."""
    move = Move(mask=3, targets=(35_000, 120_000, 0, -1), settle_ms=200)
    report = Report(ReportId.COMMAND, seq=0x0102, opcode=Opcode.MOVE, boot=0xDEADBEEF, payload=move.pack())
    body = bytes.fromhex(
        "01 01 0201 11 00 24 00 efbeadde"  # header
        "03 01 c800 b8880000 c0d40100 00000000 ffffffff"  # mask, coordinated, settle, four targets
        "00000000 00000000 00000000 00000000"  # own speeds
        "00000000 00000000 00000000"  # padding
    )
    assert len(body) == 60
    assert report.pack() == body + struct.pack("<I", zlib.crc32(body))


def test_golden_status() -> None:
    """The STATUS block, field after field at its documented offset."""
    state = State(0x01020304, (1, -2, 3, -4), 0x2301, 5, 6, 7, 8, 9, 0x0A0B0C0D, 100_000, 0x1122, 0x3344, 0x55, -6)
    packed = state.pack()
    assert len(packed) == 48
    assert packed[0:4] == bytes([4, 3, 2, 1])
    assert struct.unpack_from("<4i", packed, 4) == (1, -2, 3, -4)
    assert packed[20:28] == bytes([0x01, 0x23, 5, 0, 6, 7, 8, 9])
    assert struct.unpack_from("<IIHH", packed, 28) == (0x0A0B0C0D, 100_000, 0x1122, 0x3344)
    assert struct.unpack_from("<Ii", packed, 40) == (0x55, -6)
    assert state.homed == 1
    assert state.moving == 0
    assert state.has(Flag.SHUTTER)
    assert state.has(Flag.LAMP)
    assert state.has(Flag.LAMP_WARM)
    assert not state.has(Flag.FAULT)


def test_golden_estop_has_no_crc() -> None:
    assert estop_report() == b"\x0f" + bytes(63)


@given(reports)
def test_report_round_trip(report: Report) -> None:
    packed = report.pack()
    assert len(packed) == 64
    assert Report.unpack(packed) == report


@given(reports, st.integers(0, 64 * 8 - 1))
def test_every_single_bit_error_is_found(report: Report, bit: int) -> None:
    packed = bytearray(report.pack())
    packed[bit // 8] ^= 1 << bit % 8
    with pytest.raises(ProtocolError):
        Report.unpack(bytes(packed))


@given(st.binary(max_size=80))
def test_noise_is_no_report(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        Report.unpack(data)


def test_zeros_are_no_report() -> None:
    """What a broken USB gadget answers to a feature request."""
    with pytest.raises(ProtocolError, match="CRC"):
        Report.unpack(bytes(64))


@pytest.mark.parametrize(("offset", "value", "message"), [(1, 2, "version"), (6, 49, "length")])
def test_wrong_header_with_right_crc(offset: int, value: int, message: str) -> None:
    body = bytearray(Report(ReportId.REPLY).pack()[:60])
    body[offset] = value
    with pytest.raises(ProtocolError, match=message):
        Report.unpack(bytes(body) + struct.pack("<I", zlib.crc32(body)))


@given(states)
def test_state_round_trip(state: State) -> None:
    assert State.unpack(state.pack()) == state


@given(st.builds(Move, byte, st.tuples(i32, i32, i32, i32), u16, st.tuples(u32, u32, u32, u32), byte))
def test_move_round_trip(move: Move) -> None:
    assert Move.unpack(move.pack()) == move


@given(st.lists(u32, min_size=1, max_size=8).map(tuple), u16)
def test_expose_round_trip(open_us: tuple[int, ...], gap_ms: int) -> None:
    assert Expose.unpack(Expose(open_us, gap_ms).pack()) == Expose(open_us, gap_ms)


@given(
    st.builds(
        Config,
        st.tuples(i32, i32, i32, i32),
        st.tuples(i32, i32, i32, i32),
        st.tuples(u16, u16, u16, u16),
        st.tuples(byte, byte, byte, byte),
        u16,
    )
)
def test_config_round_trip(config: Config) -> None:
    assert Config.unpack(config.pack()) == config


def test_ident_round_trip() -> None:
    ident = Ident(firmware=7, serial="OGM-0001", capabilities=1, reset_cause=2)
    assert Ident.unpack(ident.pack()) == ident


def test_too_much_is_refused() -> None:
    with pytest.raises(ProtocolError, match="49"):
        Report(ReportId.COMMAND, payload=bytes(49)).pack()
    with pytest.raises(ProtocolError, match="9"):
        Expose((1,) * 9).pack()
    with pytest.raises(ProtocolError, match="47"):
        State.unpack(bytes(47))


def test_descriptor_declares_every_report_with_63_bytes() -> None:
    text = descriptor()
    assert text[:5] == bytes([0x06, 0x4B, 0xFF, 0x09, 0x01])
    assert bytes([0x75, 0x08, 0x95, 63]) in text
    for report in ReportId:
        assert text.count(bytes([0x85, report])) == 1
    assert text[-1] == 0xC0


def test_job_states_are_those_of_the_document() -> None:
    assert [state.name for state in JobState] == ["IDLE", "RUNNING", "DONE", "STOPPED", "FAULTED"]
