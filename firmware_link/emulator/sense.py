"""Accelerometer of an emulated device: its samples to the frames of a stream that ends with its lease.

Samples come one by one, from an interrupt on a board, and wait in a memory of a fixed size. Whole frames of them are
sent as time passes. What finds no room is lost and counted, so that the numbers of the samples show the gap.
"""

from collections.abc import Sequence

from firmware_link.emulator.device_reports import Reports
from firmware_link.emulator.device_state import Device
from firmware_link.emulator.drive_log import Outcome
from firmware_link.protocol.messages import LONGEST_SENSE_MS, MAXIMUM_SENSED_VALUES, Acceleration, Accelerometer, Sense

US_PER_MS = 1_000
RECORDS = 64  # SENSE_RECORDS of core/sense.h: two full frames of two actuators, 20 ms at 3.2 kHz
_U16, _U32 = 1 << 16, 1 << 32  # where the counters of ACCELERATION wrap


class Accelerations:
    """The stream of one device; `end_us` is when it ends by itself, None while it is off."""

    def __init__(self, device: Device, reports: Reports) -> None:
        self.end_us: int | None = None
        self._device, self._reports = device, reports
        self._number = self._frame = self._lost = 0
        self._records: list[tuple[int, int, tuple[int, ...]]] = []
        self._whole = MAXIMUM_SENSED_VALUES // (1 + device.configuration.number_of_actuators)

    def ask_for_stream(self, sense: Sense) -> Outcome:
        """Begin, renew or end the stream, and say what the accelerometer is."""
        configuration = self._device.configuration
        if not configuration.sensor_rate_mhz:
            return Outcome.REFUSED
        if sense.lease_ms:
            self.end_us = self._device.now_us + min(sense.lease_ms, LONGEST_SENSE_MS) * US_PER_MS
        else:
            self.end()
        scale, greatest = configuration.sensor_scale_nm_per_s2, configuration.sensor_greatest
        self._reports.send(Accelerometer(configuration.sensor_rate_mhz, scale, greatest, self._lost))
        return Outcome.ACCEPTED

    def take_sample(self, acceleration: int, displacements: Sequence[int], synthesis_sample: int) -> None:
        """Take a sample in counts, with the displacements (full scale/32767) of its instant."""
        number, self._number = self._number, self._number + 1
        if self.end_us is None:
            return
        if len(self._records) == RECORDS:
            self._lost += 1
            return
        self._records.append((number, synthesis_sample, (acceleration, *displacements)))

    def send(self) -> None:
        """Send every frame that is whole."""
        while len(self._records) >= self._whole:
            self._send_frame()

    def end(self) -> None:
        """End the stream; what waits is sent before."""
        while self._records:
            self._send_frame()
        self.end_us = None

    def cut(self) -> None:
        """End the stream; what waits is forgotten."""
        self._records.clear()
        self.end_us = None

    def _send_frame(self) -> None:
        """A frame ends at a gap, since only its first sample is numbered."""
        first, at, _ = self._records[0]
        count = 1
        while count < min(self._whole, len(self._records)) and self._records[count][0] == first + count:
            count += 1
        values = tuple(value for _, _, record in self._records[:count] for value in record)
        del self._records[:count]
        self._reports.send(Acceleration(self._frame % _U16, first % _U32, at % _U32, len(values), values))
        self._frame += 1
