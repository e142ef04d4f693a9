"""The C core's frame decoder by itself, through ctypes, as the twin of `FrameDecoder`."""

import ctypes

import numpy as np

from firmware_link.protocol.framing import FramingCounters, Signal

_u8_p, _u32_p = ctypes.POINTER(ctypes.c_uint8), ctypes.POINTER(ctypes.c_uint32)
# As c/decoder.c defines them: each with its result and its arguments.
_SIGNATURES = {
    "decoder_open": (ctypes.c_void_p, ctypes.c_uint8),
    "decoder_close": (None, ctypes.c_void_p),
    "decoder_receive": (ctypes.c_size_t, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t, _u8_p),
    "decoder_counters": (None, ctypes.c_void_p, _u32_p),
}
_LENGTH_SIZE = 2
# More than any frame: a body is shorter than its frame, which may have come in pieces before.
_FRAME_ROOM = 65_536


class CompiledDecoder:
    """The C core's frame decoder by itself."""

    def __init__(self, library: ctypes.CDLL, number_of_actuators: int) -> None:
        for name, (result, *arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        self._library = library
        self._decoder = library.decoder_open(number_of_actuators)

    def close(self) -> None:
        """Free the decoder; nothing else may be called afterwards."""
        self._library.decoder_close(self._decoder)

    @property
    def counters(self) -> FramingCounters:
        """Frames accepted and refused since the decoder was made."""
        counters = (ctypes.c_uint32 * 5)()
        self._library.decoder_counters(self._decoder, counters)
        return FramingCounters(*counters)

    def receive(self, data: bytes) -> list[bytes | Signal]:
        """Bodies with a valid checksum and length, and emergency stops, in the order of the stream."""
        out = np.empty(3 * len(data) + _FRAME_ROOM, np.uint8)
        size = self._library.decoder_receive(self._decoder, data, len(data), out.ctypes.data_as(_u8_p))
        return _split(out[:size].tobytes())


def _split(items: bytes) -> list[bytes | Signal]:
    received: list[bytes | Signal] = []
    at = 0
    while at < len(items):
        length = int.from_bytes(items[at : at + _LENGTH_SIZE], "little")
        at += _LENGTH_SIZE
        received.append(items[at : at + length] if length else Signal.EMERGENCY_STOP)
        at += length
    return received
