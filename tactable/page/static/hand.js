// Drives by hand: three sliders for each actuator, and what the bar does in one sentence.

const EVERY_MS = 120; // Between two drives while a slider moves.
const REPEAT_MS = 250; // A real board plays a drive for 1 s, unless it is said again.
const PARTS = [
  { name: "frequency", unit: " Hz", step: 0.5, digits: 1 },
  { name: "amplitude", unit: " %", step: 0.5, digits: 1 },
  { name: "phase", unit: "°", step: 1, digits: 0 },
];

export class Hand {
  // `onChange` gets the drive of the sliders: [Hz, fraction of full scale, degrees] of each actuator.
  constructor(box, onChange) {
    this._box = box;
    this._onChange = onChange;
    this._isAsked = false;
    this._isOurs = false; // Whether this browser asked a real board for the drive, and repeats it.
    setInterval(() => { if (this._isOurs && !this._box.hidden && !this._waits) this._onChange(this._channels()); }, REPEAT_MS);
    this._sliders = [];
    this._sent_ms = -EVERY_MS;
    this._waits = 0;
    this._key = "";
  }

  // Show the sliders of a scene; those that a person holds stay where they are.
  set scene({ device, choice }) {
    const isShown = choice?.source === "hand" && choice.hand !== null;
    this._box.hidden = !isShown;
    this._isOurs &&= isShown || this._isAsked;
    this._isAsked &&= !isShown;
    if (!isShown) return;
    this._length_m = device.length_m;
    const key = JSON.stringify([device.name, device.actuators, device.most]);
    if (key !== this._key) this._build(device);
    this._key = key;
    choice.hand.forEach(([hz, amplitude, degrees], i) => {
      [hz, 100 * amplitude, degrees].forEach((value, part) => {
        const slider = this._sliders[i][part];
        if (document.activeElement !== slider || !this._waits) slider.value = value;
        this._say(slider, PARTS[part]);
      });
    });
  }

  _build({ actuators, most }) {
    this._sliders = [];
    this._box.replaceChildren(...actuators.map(({ name, band_hz }) => {
      const set = document.createElement("fieldset"), legend = document.createElement("legend");
      legend.textContent = name;
      set.append(legend);
      const ranges = [band_hz, [0, 100 * most], [-180, 180]];
      this._sliders.push(PARTS.map((part, i) => {
        const label = document.createElement("label"), slider = document.createElement("input"), output = document.createElement("output");
        slider.type = "range";
        [slider.min, slider.max] = ranges[i];
        slider.step = part.step;
        slider.setAttribute("aria-label", `${part.name} of ${name}`);
        slider.addEventListener("input", () => { this._say(slider, part); this._change(); });
        label.append(part.name, slider, output);
        set.append(label);
        return slider;
      }));
      return set;
    }));
  }

  _say(slider, { digits, unit }) {
    const text = Number(slider.value).toFixed(digits) + unit;
    slider.nextElementSibling.textContent = text.replace("-", "−");
    slider.setAttribute("aria-valuetext", text);
  }

  // Send the drive now, or when the one before was sent long enough ago.
  _change() {
    if (this._waits) return;
    const wait_ms = Math.max(0, this._sent_ms + EVERY_MS - performance.now());
    this._waits = setTimeout(() => {
      this._waits = 0;
      this._sent_ms = performance.now();
      this._onChange(this._channels());
    }, wait_ms);
  }

  _channels() {
    return this._sliders.map(([hz, percent, degrees]) => [Number(hz.value), Number(percent.value) / 100, Number(degrees.value)]);
  }

  // From now on this browser repeats the drive once its sliders are there.
  take() { this._isOurs = this._isAsked = true; }

  // The present level along the bar; null where no drive by hand plays.
  says(picture) {
    if (this._box.hidden || !picture.levelCount) return null;
    let most = 0, least = 0;
    for (let i = 1; i < picture.levelCount; i++) {
      if (picture.counted[i] > picture.counted[most]) most = i;
      if (picture.counted[i] < picture.counted[least]) least = i;
    }
    const at = (i) => `${(1000 * this._length_m * i / (picture.levelCount - 1)).toFixed(0)} mm`;
    const level = (i) => `${picture.counted[i].toFixed(0).replace("-", "−")} dB`;
    if (picture.counted[most] <= -59) return "By hand: the bar is still.";
    return `By hand: ${level(most)} at ${at(most)}, ${level(least)} at ${at(least)}.`;
  }
}
