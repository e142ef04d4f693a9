"""The wire between host and device: its protocol, the host side, the emulated device and the firmware."""

BIT_RATE_HZ = 921_600  # of a serial line unless another is given: that of the board with a UART; USB ignores it
