// The emergency stop: by its own port, by the API as well, and an honest word on what came of it.

const APART_MS = 300; // the own way has this much for itself
const ANSWER_MS = 2000;
const TRIES = 5;
const AGAIN_MS = 1000;
const SEEN_MS = 200;

class Unconfirmed extends Error {}

async function tell(url, way, options = {}) {
  let response;
  try {
    response = await fetch(url, { method: "POST", cache: "no-store", signal: AbortSignal.timeout(ANSWER_MS), ...options });
  } catch (error) {
    throw new Unconfirmed(`${way}: ${error.name === "TimeoutError" ? `no answer within ${ANSWER_MS / 1000} s` : "cannot be reached"}`);
  }
  if (response.ok) return way;
  const told = await response.json().then((answer) => answer.detail, () => null);
  throw new Unconfirmed(`${way}: ${told ?? `answered ${response.status}`}`);
}

// Where the stop's own way is, for a page that came from here; null: a page under TLS may not ask plain HTTP.
export function ownWay(port, at = location) {
  if (at.protocol !== "http:" || !port) return null;
  return `http://${at.hostname}:${port}/api/stop`;
}

// Both ways once; resolves with the way that confirmed it, rejects with why none did.
function once(url, credentials) {
  const own = url ? tell(url, "the stop's own way", { credentials }) : Promise.reject(new Unconfirmed("the stop's own way: not known here"));
  const waited = new Promise((resolve) => {
    setTimeout(resolve, APART_MS);
    own.catch(resolve);
  });
  const api = Promise.race([own.then(() => new Promise(() => {}), () => {}), waited]).then(() => tell("api/stop", "the API"));
  return Promise.any([own, api]).catch((all) => {
    throw new Unconfirmed(all.errors.map((one) => one.message).join("; "));
  });
}

export class Stop {
  // port(): of the stop's own way, as last heard. loggedIn(): is there a cookie that it has to see?
  // told({state, text}): state is asking, stopped or unconfirmed.
  // stopped(): does the newest status show a stop already?
  constructor({ port, loggedIn, stopped, told }) {
    this.port = port;
    this.loggedIn = loggedIn;
    this.stopped = stopped;
    this.told = told;
    this.asked = 0; // counts presses: an older one says nothing any more
    this.open = false;
  }

  async press() {
    const mine = ++this.asked;
    const began = (this.began = performance.now());
    this.before = this.stopped();
    this.open = true;
    this.told({ state: "asking", text: "Stopping …" });
    for (let tried = 1; tried <= TRIES && this.open && mine === this.asked; tried++) {
      try {
        const way = await once(ownWay(this.port()), this.loggedIn() ? "include" : "omit");
        if (this.open && mine === this.asked) this.confirmed(`confirmed by ${way} after ${Math.round(performance.now() - began)} ms`);
        return;
      } catch (error) {
        if (!this.open || mine !== this.asked) return;
        const next = tried < TRIES ? "Still trying." : "Gave up trying: press again.";
        this.told({ state: "unconfirmed", text: `NOT confirmed: use the button on the wall. ${error.message}. ${next}` });
        await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
      }
    }
    this.open = false;
  }

  // A live status that shows the stop counts, too, unless it showed one before; an answer says more, and has time first.
  seen() {
    if (this.open && !this.before && performance.now() - this.began > SEEN_MS) this.confirmed("the robot's status shows it");
  }

  confirmed(how) {
    this.open = false;
    this.told({ state: "stopped", text: `Stopped at ${new Date().toLocaleTimeString("en-GB")}: ${how}.` });
  }
}

const TYPING = new Set(["text", "password", "search", "email", "url", "tel", ""]);

// Does a space belong to a text that somebody types here?
function typing(node) {
  if (node instanceof HTMLTextAreaElement || node?.isContentEditable) return true;
  return node instanceof HTMLInputElement && TYPING.has(node.type);
}

// Space, wherever the focus is; the button that has it is not pressed. The button itself acts when it is touched.
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
    if (performance.now() - touched > 1000) press(); // by Enter, or by what helps a person to press
  });
}
