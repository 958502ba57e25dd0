"""One table of scenarios, and every implementation of the rig's side of the protocol: any difference fails."""

import ctypes
import random

import pytest
from c_rig import CDevice
from rig_conformance import PythonDevice, differences, run
from rig_scenarios import (
    ANY,
    ESTOP,
    HOMED,
    SCENARIOS,
    Again,
    Happen,
    Pass,
    Scenario,
    Send,
    Step,
    clear,
    expose,
    hello,
    home,
    intensity,
    lamp,
    move,
    shutter,
    stop,
    watchdog,
)

from kinran.rig.protocol import VALIDATE_ONLY, Opcode, descriptor

BY_NAME = pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)


def test_the_table_is_a_table() -> None:
    assert len({scenario.name for scenario in SCENARIOS}) == len(SCENARIOS) >= 45


@BY_NAME
def test_the_simulated_firmware(scenario: Scenario) -> None:
    run(scenario, PythonDevice())


@BY_NAME
def test_the_firmware_in_c(scenario: Scenario, c_rig: ctypes.CDLL) -> None:
    """It does what the table says, and the same as the simulated firmware where the table says nothing."""
    assert differences(run(scenario, PythonDevice()), run(scenario, CDevice(c_rig))) == []


def test_the_descriptor_in_c(c_rig: ctypes.CDLL) -> None:
    assert CDevice(c_rig).descriptor() == descriptor()


def random_steps(seed: int, count: int) -> tuple[Step, ...]:
    """What a host may send in any order, with what may happen to a rig; replies are left open."""
    draw = random.Random(seed)
    theta, phi, camera = range(0, 95_000, 5_000), range(-20_000, 380_000, 10_000), range(-80_000, 85_000, 5_000)

    def anything() -> Step:
        target = (draw.choice(theta), draw.choice(phi), draw.choice((0, draw.choice(camera))), draw.choice(phi))
        speeds = (draw.choice((0, 0, 3_000)), draw.choice((0, 0, 20_000)), 0, 0)
        steps: list[Step] = [
            move(*target, mask=draw.choice((1, 2, 3, 3, 3, 7, 15, 16)), settle_ms=draw.choice((0, 200)), speeds=speeds),
            move(*target, mask=3, flags=VALIDATE_ONLY), home(draw.choice((15, 15, 1, 6, 0))), stop(), ESTOP,
            lamp(draw.random() < 0.7), shutter(draw.choice((0, 300, 5_000, 60_000))), intensity(draw.choice((0, 100))),
            watchdog(draw.choice((0, 700, 2_000))), clear(draw.choice((0, 1, 1, 5, 5, 8, 8, 9))), hello(),
            expose(*draw.choices((250, 4_000, 599_500), k=draw.randint(1, 8)), gap_ms=draw.choice((0, 20, 300))),
            Send(Opcode.NOP), Send(draw.randrange(256), draw.randbytes(draw.randrange(49))),
            Send(Opcode.NOP, flip=draw.randrange(1, 64)), Send(Opcode.NOP, stale=True), Again(draw.randint(1, 2)),
            Happen("door_open"), Happen("door_closed"), Happen("door_closed"), Happen("x_sync_out"),
            Happen("x_sync_in"), Happen("exposure"),
        ]  # fmt: skip
        return draw.choice(steps)

    def step() -> Step:
        """As likely as not one that lets time pass, or that makes a rig usable again after a fault."""
        chance = draw.random()
        if chance < 0.4:
            return Pass(draw.choice((0.003, 0.05, 0.3, 1.1, 6.1, 12.3)), fed=draw.random() < 0.5)
        if chance < 0.55:
            mends: list[Step] = [Happen("door_closed"), clear(1), clear(5), clear(8), clear(9), home(15), hello()]
            return draw.choice(mends)
        return anything()

    return tuple(open_ended(step()) for _ in range(count))


def open_ended(step: Step) -> Step:
    """Leave the reply of a command open."""
    if isinstance(step, Send):
        return Send(step.opcode, step.payload, ANY, step.flags, step.seq, step.stale, step.flip)
    return step


@pytest.mark.parametrize("seed", range(40))
def test_both_do_the_same_with_anything(seed: int, c_rig: ctypes.CDLL) -> None:
    scenario = Scenario(f"random steps {seed}", (*HOMED, *random_steps(seed, 150)))
    assert differences(run(scenario, PythonDevice()), run(scenario, CDevice(c_rig))) == []
