"""Test vectors of the wire: `python -m tests.firmware_link.codegen.vectors` rewrites `firmware_link/vectors/`.

A line is `name | values | body | frame`. Another implementation encodes the values and must get the bytes, and decodes
the bytes and must get the values.
"""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

import firmware_link
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.protocol import drive_words, messages
from firmware_link.protocol.basis import Basis, BasisSet, clamp_samples, sample_limits, transfer_messages, weighted_sum
from firmware_link.protocol.framing import encode_frame, encode_message
from firmware_link.protocol.layout import Message
from tests.firmware_link.law_host import greeting
from tests.firmware_link.virtual_rig import decode_messages

FOLDER = Path(firmware_link.__file__).parent / "vectors"
RESOLUTION_HZ = 0.01
HIGHEST_UHZ = 200_000_000
_FIRST_SEQUENCE = 254
_BOOT_ID = 0x00ABCD00


def example_basis() -> Basis:
    """Two sets of functions for two actuators."""
    two = np.array([[0, 16_384, 32_767, 16_384, 0], [0, -32_767, 0, 32_767, 0], [0, 12_000, 30_000, 12_000, 0]])
    one = np.array([[0, 32_767, 0], [0, -20_000, 0]])
    actuators = np.array([0, 0, 1], np.uint8)
    return Basis(1000, (BasisSet(two.astype(np.int16), actuators), BasisSet(one.astype(np.int16), actuators[1:])))


def example_plays() -> tuple[messages.Play, ...]:
    """Clicks of the example basis: an ordinary one, one that is clamped, and one of the other set."""
    return (
        messages.Play(1000, 0, 14, messages.FULL_SCALE_WORD, 3, (8_192, -4_096, 16_384)),
        messages.Play(65_535, 0, 1, 32_768, 3, (-32_768, 32_767, 1)),
        messages.Play(1000, 1, 15, messages.FULL_SCALE_WORD, 2, (16_384, -32_767)),
    )


def example_messages() -> tuple[Message, ...]:
    """One example or more of every message type, for two actuators."""
    drive = drive_words.encode_drive(
        [drive_words.ChannelDrive(60, 1.0, 0.0), drive_words.ChannelDrive(60, 0.5, 1.5707963267948966)], RESOLUTION_HZ
    )
    full_scales_pm = (520_000, 0x00FF00FF)
    device = EmulatedFirmware(DeviceConfiguration(_BOOT_ID, full_scales_pm=full_scales_pm, basis_capacity_bytes=65_536))
    hello, *_ = decode_messages(device.receive(encode_message(greeting(0x01020304), 1), 0))
    assert isinstance(hello, messages.Hello)
    return (
        greeting(0x01020304),
        replace(hello, firmware_minor=1),
        messages.Arm(_BOOT_ID, 200, 40, 0, (65_535, 32_768)),
        messages.Ack(messages.Arm.type_byte, 3, messages.Result.OK),
        messages.Ack(messages.Arm.type_byte, 0, messages.Result.WRONG_BOOT),
        messages.Set(1000, messages.SetFlag.WRITE_PHASE, 40, drive),
        messages.Set(65_535, messages.SetFlag(0), 100, bytes(12)),
        messages.KeepAlive(0, 7),
        messages.Stop(),
        messages.TimeRequest(2**63),
        messages.Time(2**63, 1_000_000, 1_000_001),
        messages.Status(
            messages.DeviceState.DRIVING, messages.FaultCode.NONE, 7, 2**40, 2**40 - 1, 4000, 1, 2, 3, 4, 5, 6, 7, 8, 9
        ),
        messages.Fault(messages.FaultCode.SILENT_HOST, 251_000),
        messages.Log(messages.LogLevel.WARNING, messages.LogCode.LEASE_EXPIRED, 7, 41_000),
        *transfer_messages(example_basis().data),
        *example_plays(),
        messages.Sense(500),
        messages.Accelerometer(3_200_000, 38_303_000, 4_095, 0),
        messages.Acceleration(65_535, 2**32 - 1, 48_000, 6, (256, 32_767, -1, -4_096, -32_767, 0)),
    )


def message_lines() -> list[str]:
    """One line for each example; sequences count from 254 on, so that they wrap."""
    lines = []
    for index, message in enumerate(example_messages()):
        body = messages.encode_body(message, (_FIRST_SEQUENCE + index) % 256)
        values = " ".join(f"{f.name}={_value_text(getattr(message, f.name))}" for f in fields(message))
        lines.append(f"{message.wire_name} | sequence={body[1]} {values}".rstrip() + f" | {body.hex()} | {_hex(body)}")
    return lines


def basis_lines() -> list[str]:
    return [f"basis | {example_basis().data.hex()} | {example_basis().hash:08x}"]


def waveform_lines() -> list[str]:
    """For each example of a PLAY: its body and the samples of both actuators, instant by instant."""
    basis, lines = example_basis(), []
    for index, play in enumerate(example_plays()):
        sums = weighted_sum(basis.sets[play.basis_set], play.weights, play.fraction_bits, 2)
        samples = clamp_samples(
            sums, sample_limits((messages.FULL_SCALE_WORD, 32_768), HIGHEST_UHZ, basis.sample_rate_hz)
        )
        text = " ".join(",".join(map(str, instant)) for instant in samples.tolist())
        lines.append(f"waveform | {messages.encode_body(play, index).hex()} | {text}")
    return lines


def write_vectors(folder: Path = FOLDER) -> None:
    folder.mkdir(exist_ok=True)
    for name, lines in vector_files().items():
        (folder / name).write_text("\n".join([_MADE_BY, *_HEADS[name], *lines]) + "\n", encoding="ascii")


def vector_files() -> dict[str, list[str]]:
    return {"messages.txt": message_lines(), "basis.txt": basis_lines(), "waveforms.txt": waveform_lines()}


_MADE_BY = "# Made by `python -m tests.firmware_link.codegen.vectors`."
_HEADS = {
    "messages.txt": ["# name | values | body | frame"],
    "basis.txt": ["# basis | its bytes for two actuators | its hash"],
    "waveforms.txt": [
        "# The example basis; amplitude limits 65535 and 32768, highest frequency 200 Hz, two actuators.",
        "# waveform | body of the PLAY | samples of both actuators, instant by instant",
    ],
}


def _hex(body: bytes) -> str:
    return encode_frame(body).hex()


def _value_text(value: object) -> str:
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return str(int(value))  # type: ignore[call-overload]  # what is no block is an integer


if __name__ == "__main__":
    write_vectors()
