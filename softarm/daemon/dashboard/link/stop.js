// The emergency stop: sent to the dedicated stop port and to the API, with a report of which one confirmed it.

const API_DELAY_MS = 300; // head start of the dedicated port
const ANSWER_MS = 2000;
const TRIES = 5;
const RETRY_MS = 1000;
const STATUS_DELAY_MS = 200; // an answer names its port, so it takes precedence over the status

class Unconfirmed extends Error {}

async function send(url, port, options = {}) {
  let response;
  try {
    response = await fetch(url, { method: "POST", cache: "no-store", signal: AbortSignal.timeout(ANSWER_MS), ...options });
  } catch (error) {
    throw new Unconfirmed(`${port}: ${error.name === "TimeoutError" ? `no answer within ${ANSWER_MS / 1000} s` : "cannot be reached"}`);
  }
  if (response.ok) return port;
  const reason = await response.json().then((answer) => answer.detail, () => null);
  throw new Unconfirmed(`${port}: ${reason ?? `answered ${response.status}`}`);
}

// Return the URL of the dedicated stop port, or null on a page over TLS, which must not send plain HTTP.
function stopUrl(port) {
  if (location.protocol !== "http:" || !port) return null;
  return `http://${location.hostname}:${port}/api/stop`;
}

// Send to both ports once; resolve with the port that confirmed, reject with the reasons of both.
function once(url, credentials) {
  const dedicated = url ? send(url, "the dedicated stop port", { credentials }) : Promise.reject(new Unconfirmed("the dedicated stop port: not available on this page"));
  const waited = new Promise((resolve) => {
    setTimeout(resolve, API_DELAY_MS);
    dedicated.catch(resolve);
  });
  const api = Promise.race([dedicated.then(() => new Promise(() => {}), () => {}), waited]).then(() => send("api/stop", "the API"));
  return Promise.any([dedicated, api]).catch((all) => {
    throw new Unconfirmed(all.errors.map((one) => one.message).join("; "));
  });
}

export class Stop {
  // port() returns the dedicated port. loggedIn() returns whether the request needs the cookie.
  // stopped() returns whether the newest status shows a stop. onResult({state, text}): asking, stopped, unconfirmed.
  constructor({ port, loggedIn, stopped, onResult }) {
    this.port = port;
    this.loggedIn = loggedIn;
    this.stopped = stopped;
    this.onResult = onResult;
    this.presses = 0; // a newer press replaces the reports of an older one
    this.open = false;
  }

  async press() {
    const mine = ++this.presses;
    const isOpen = () => this.open && mine === this.presses;
    const began = (this.began = performance.now());
    this.before = this.stopped();
    this.open = true;
    this.onResult({ state: "asking", text: "Stopping …" });
    for (let attempt = 1; attempt <= TRIES && isOpen(); attempt++) {
      try {
        const via = await once(stopUrl(this.port()), this.loggedIn() ? "include" : "omit");
        if (isOpen()) this.confirmed(`confirmed via ${via} in ${Math.round(performance.now() - began)} ms`);
        return;
      } catch (error) {
        if (!isOpen()) return;
        const next = attempt < TRIES ? "Retrying." : "No further attempts: press Stop again.";
        this.onResult({ state: "unconfirmed", text: `NOT confirmed. Use the emergency-stop button. ${error.message}. ${next}` });
        await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
      }
    }
    if (isOpen()) this.open = false;
  }

  // Accept a live status as confirmation, unless it showed a stop before the press.
  statusShowsStop() {
    if (this.open && !this.before && performance.now() - this.began > STATUS_DELAY_MS) this.confirmed("confirmed by the robot's status");
  }

  confirmed(how) {
    this.open = false;
    this.onResult({ state: "stopped", text: `Stopped at ${new Date().toLocaleTimeString("en-GB")}: ${how}.` });
  }
}

const TYPING = new Set(["text", "password", "search", "email", "url", "tel", ""]);

// Return whether a space belongs to the text in this field.
function typing(node) {
  if (node instanceof HTMLTextAreaElement || node?.isContentEditable) return true;
  return node instanceof HTMLInputElement && TYPING.has(node.type);
}

// Bind Space, wherever the focus is, without pressing the focused button. The stop button acts on pointer down.
export function bindStop(button, press) {
  const key = (event) => {
    if (event.code !== "Space" || event.ctrlKey || event.altKey || event.metaKey || typing(event.target)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (event.type === "keydown" && !event.repeat) press();
  };
  for (const kind of ["keydown", "keypress", "keyup"]) window.addEventListener(kind, key, { capture: true });
  let touched = -Infinity;
  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    touched = performance.now();
    press();
  });
  button.addEventListener("click", () => {
    if (performance.now() - touched > 1000) press(); // by Enter or an assistive device
  });
}
