"""Definition of the wire: messages, frames, bases of waveforms, and the rate that a line carries."""
