"""Touch digitizers of this machine: listed, mapped, recorded."""
