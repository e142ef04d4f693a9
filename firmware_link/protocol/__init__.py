"""Definition of the wire: messages, frames, banks of waveforms, and the rate that a line carries."""
