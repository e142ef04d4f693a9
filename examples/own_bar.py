"""A bar of your own and its modes: what an actuator can move, and what a finger damps.

python examples/own_bar.py
"""

from tactable import find_device, modes, response

# A shipped description, changed where your bar differs. A file of your own: Device.read("my-bar.toml").
bar = find_device("reference-a").with_values({"bar.length": "240 mm", "actuator[2].position": "200 mm"})

free = modes(bar, up_to_hz=300)
held = modes(bar, fingers=["120 mm"], up_to_hz=300)  # the device's standard finger in the middle
for name, found in ("untouched", free), ("finger at 120 mm", held):
    lines = zip(found.frequency.values, found.decay_time.values, strict=True)
    print(f"{name}:", ", ".join(f"{hz:.0f} Hz (decays in {1e3 * s:.0f} ms)" for hz, s in lines))

# Complex acceleration (frequency, actuator, position) in m/s², one actuator at full scale and the other still.
at_modes = abs(response(bar, frequency_hz=free.frequency.values))
loudest = at_modes.max("position")
for number, hz in enumerate(free.frequency.values):
    peaks = zip(loudest.actuator.values, loudest[number].values, strict=True)
    print(f"at {hz:.0f} Hz, full scale:", ", ".join(f"{name} {peak:.1f} m/s²" for name, peak in peaks))
