"""HID reports to touch frames, and touch frames to fingers on the bar."""
