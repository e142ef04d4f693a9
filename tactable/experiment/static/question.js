// The question page: shows the state that the server sends, and sends back which button was pressed and when.
const at = (id) => document.getElementById(id);
const KEYS = { ArrowLeft: 0, ArrowRight: 1, ArrowUp: 2, ArrowDown: 3 };
let socket = null;
let state = { number: -1, kind: "wait", choices: [] };
let shown_ms = 0;
let isAnswered = false;

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function answer(choice) {
  if (isAnswered || choice >= state.choices.length || socket?.readyState !== WebSocket.OPEN) return;
  isAnswered = true;
  send({ number: state.number, choice, after_ms: performance.now() - shown_ms });
  for (const button of at("choices").children) button.disabled = true;
}

function button(text, choice) {
  const made = document.createElement("button");
  made.type = "button";
  const key = document.createElement("kbd");
  key.textContent = state.choices.length > 1 ? String(choice + 1) : "Enter";
  made.append(text, " ", key);
  made.addEventListener("click", () => answer(choice));
  return made;
}

function show(news) {
  const isOther = news.number !== state.number;
  state = news;
  document.body.dataset.kind = state.kind;
  at("done").value = state.done;
  at("text").textContent = state.text;
  at("intervals").hidden = state.kind !== "interval";
  const spans = [...at("intervals").children];
  spans.forEach((span, k) => {
    span.hidden = k >= (state.intervals ?? 0);
    span.toggleAttribute("data-lit", k === state.lit);
  });
  at("intervals").ariaLabel = state.lit === null ? "wait" : `moment ${state.lit + 1}`;
  if (!isOther) return;
  isAnswered = false;
  shown_ms = performance.now();
  at("choices").replaceChildren(...state.choices.map(button));
}

function connect() {
  const address = new URL("answers", location.href);
  address.protocol = "ws:";
  socket = new WebSocket(address);
  socket.addEventListener("message", (event) => show(JSON.parse(event.data)));
  socket.addEventListener("close", () => {
    if (state.kind === "done") return;
    at("text").textContent = "The connection is lost. It is tried again.";
    at("choices").replaceChildren();
    state = { ...state, number: -1 };
    setTimeout(connect, 500);
  });
}

at("stop").addEventListener("click", () => send({ stop: true }));
addEventListener("keydown", (event) => {
  if (event.repeat) return;
  if (event.key === "Escape") send({ stop: true });
  else if (event.key === "Enter" && state.choices.length === 1 && document.activeElement.tagName !== "BUTTON") answer(0);
  else if (event.key in KEYS && state.choices.length > 1) answer(KEYS[event.key]);
  else if (/^[1-9]$/.test(event.key) && state.choices.length > 1) answer(Number(event.key) - 1);
});
connect();
