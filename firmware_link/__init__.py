"""The wire between host and device: its protocol, the host side, the emulated device and the firmware."""
