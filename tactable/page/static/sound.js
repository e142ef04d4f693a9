// Plays what a finger felt through the loudspeaker, since vibration lies in the audible band.

export class Sound {
  constructor() {
    this.played = 0;
    this._context = null;
  }

  // Browsers allow sound only after an action of the user.
  wake() {
    this._context ??= new AudioContext();
    if (this._context.state === "suspended") this._context.resume();
  }

  play({ rate_hz, samples }) {
    if (!this._context || !samples.length) return;
    const buffer = this._context.createBuffer(1, samples.length, rate_hz);
    const faded = buffer.getChannelData(0), fade = Math.min(240, samples.length >> 2);
    faded.set(samples);
    for (let i = 0; i < fade; i++) {
      faded[i] *= i / fade;
      faded[samples.length - 1 - i] *= i / fade;
    }
    const node = this._context.createBufferSource();
    node.buffer = buffer;
    node.connect(this._context.destination);
    node.start();
    this.played++;
  }
}
