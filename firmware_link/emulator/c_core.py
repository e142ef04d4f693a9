"""C core of the firmware, loaded into this process through ctypes.

`make host` in `firmware/` builds the library. `CompiledFirmware` is used like its Python twin `EmulatedFirmware`.
"""

import ctypes
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_link.emulator.device_state import FULL_SCALE_PM, DeviceConfiguration, DeviceCounters
from firmware_link.protocol.framing import FramingCounters
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import DeviceState

_NEVER_US = 2**64 - 1  # the C core's word for "nothing is due", UINT64_MAX
_TAKE_SIZE = 65_536  # taken until it is empty: bounds one call, not what was sent
_i16_p, _u16_p, _u32_p = (ctypes.POINTER(kind) for kind in (ctypes.c_int16, ctypes.c_uint16, ctypes.c_uint32))
# As host/host.h declares them: the options of a device, then the functions, each with its result and its arguments.
_OPTIONS = [field.name for field in fields(DeviceConfiguration) if field.name != "full_scales_pm"]
_SIGNATURES = {
    "host_open": (ctypes.c_void_p, _u32_p, _u32_p, ctypes.c_bool),
    "host_close": (None, ctypes.c_void_p),
    "host_receive": (None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_uint64),
    "host_advance": (None, ctypes.c_void_p, ctypes.c_uint64),
    "host_hang_up": (None, ctypes.c_void_p, ctypes.c_uint64),
    "host_sense_at": (None, ctypes.c_void_p, ctypes.c_int16, _i16_p, ctypes.c_uint32),
    "host_senses": (ctypes.c_bool, ctypes.c_void_p),
    "host_take_sent": (ctypes.c_size_t, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t),
    "host_take_samples": (ctypes.c_size_t, ctypes.c_void_p, _i16_p, ctypes.c_size_t),
    "host_next_deadline_us": (ctypes.c_uint64, ctypes.c_void_p),
    "host_state": (ctypes.c_uint8, ctypes.c_void_p),
    "host_allows_high_voltage": (ctypes.c_bool, ctypes.c_void_p),
    "host_amplitudes": (None, ctypes.c_void_p, _u16_p, _u16_p),
    "host_counters": (None, ctypes.c_void_p, _u32_p),
}


def open_library(path: Path) -> ctypes.CDLL:
    """Load the library that `make host` built; raises LinkError for a file that is not that library."""
    try:
        library = ctypes.CDLL(str(path))
        for name, (result, *arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        raise LinkError(f"{path} is no library of the firmware ({error}): build it with make host") from error
    return library


class CompiledFirmware:
    """The C core with virtual time: the caller owns the clock, which must not run backwards.

    Its synthesis runs along; `take_samples` returns the samples, unless `keeps_samples` is off. Raises LinkError for a
    configuration that the core refuses.
    """

    def __init__(self, library: ctypes.CDLL, configuration: DeviceConfiguration, *, keeps_samples: bool = True) -> None:
        self.configuration = configuration
        self._library = library
        self._buffer = ctypes.create_string_buffer(_TAKE_SIZE)
        options = [getattr(configuration, name) for name in _OPTIONS]
        full_scales_pm = configuration.full_scales_pm or (FULL_SCALE_PM,) * configuration.number_of_actuators
        self._host = library.host_open(_words(options), _words(full_scales_pm), keeps_samples)
        if not self._host:
            raise LinkError(f"the C core refuses {configuration}")

    def close(self) -> None:
        """Free the device; nothing else may be called afterwards."""
        self._library.host_close(self._host)

    @property
    def state(self) -> DeviceState:
        """State of the firmware: what it allows."""
        return DeviceState(self._library.host_state(self._host))

    @property
    def allows_high_voltage(self) -> bool:
        """Whether the board may keep its supply on."""
        return bool(self._library.host_allows_high_voltage(self._host))

    @property
    def counters(self) -> DeviceCounters:
        """Counters of the firmware since boot."""
        return DeviceCounters(*self._counters()[:4])

    @property
    def framing_counters(self) -> FramingCounters:
        """Frames accepted and refused since boot."""
        return FramingCounters(*self._counters()[4:])

    def amplitudes(self) -> list[tuple[int, int]]:
        """Amplitude of each oscillator as it is and as it is aimed at, in full scale/65535."""
        number = self.configuration.number_of_actuators
        now, aimed = (ctypes.c_uint16 * number)(), (ctypes.c_uint16 * number)()
        self._library.host_amplitudes(self._host, now, aimed)
        return list(zip(now, aimed, strict=True))

    @property
    def senses(self) -> bool:
        """Whether samples of the accelerometer are wanted."""
        return bool(self._library.host_senses(self._host))

    def sense(self, acceleration: int, displacements: Sequence[int], synthesis_sample: int) -> None:
        """Take a sample of the accelerometer in counts, with the displacements (full scale/32767) of its instant."""
        values = (ctypes.c_int16 * len(displacements))(*displacements)
        self._library.host_sense_at(self._host, acceleration, values, synthesis_sample % 2**32)

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes that came at `now_us`; returns what the device sends until then."""
        self._library.host_receive(self._host, data, len(data), now_us)
        return self._take_sent()

    def run_until(self, now_us: int) -> bytes:
        """Let time pass up to `now_us`; returns what the device sends until then."""
        self._library.host_advance(self._host, now_us)
        return self._take_sent()

    def hang_up(self, now_us: int) -> bytes:
        """The host let go of the line, or pulled it; returns what the device sends until then."""
        self._library.host_hang_up(self._host, now_us)
        return self._take_sent()

    def next_deadline_us(self) -> int | None:
        """Time at which the device acts by itself next; None while it waits for a host."""
        deadline_us: int = self._library.host_next_deadline_us(self._host)
        return None if deadline_us == _NEVER_US else deadline_us

    def take_samples(self) -> NDArray[np.int16]:
        """Displacements (time, actuator) of every sample since the last call, 32767 = full scale."""
        number = self._library.host_take_samples(self._host, None, 0)
        samples = np.empty((number, self.configuration.number_of_actuators), np.int16)
        if number:
            self._library.host_take_samples(self._host, samples.ctypes.data_as(_i16_p), number)
        return samples

    def _counters(self) -> list[int]:
        counters = (ctypes.c_uint32 * 9)()
        self._library.host_counters(self._host, counters)
        return list(counters)

    def _take_sent(self) -> bytes:
        sent = b""
        while size := self._library.host_take_sent(self._host, self._buffer, _TAKE_SIZE):
            sent += ctypes.string_at(self._buffer, size)
        return sent


def _words(values: Sequence[int]) -> "ctypes.Array[ctypes.c_uint32]":
    return (ctypes.c_uint32 * len(values))(*values)
