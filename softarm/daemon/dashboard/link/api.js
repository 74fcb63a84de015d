// HTTP requests with a time limit. A refusal carries the daemon's reasons.

export class Refused extends Error {
  // status: the HTTP status, or 0 if the daemon did not answer
  constructor(status, reasons) {
    super(reasons.join("; "));
    this.status = status;
    this.reasons = reasons;
  }
}

const watchers = new Set();
// Register a function that is called when the daemon answers that the user is not logged in.
export const onLoggedOut = (watcher) => watchers.add(watcher);

export async function ask(method, path, body, { seconds = 5, raw = false } = {}) {
  const options = { method, cache: "no-store", signal: AbortSignal.timeout(seconds * 1000) };
  if (body !== undefined) {
    options.headers = { "Content-Type": "application/json" };
    options.body = JSON.stringify(body);
  }
  let response;
  try {
    response = await fetch(path, options);
    if (response.ok) return raw ? response : await response.json();
  } catch (error) {
    const late = error.name === "TimeoutError";
    throw new Refused(0, [late ? `no answer within ${seconds} s` : "the daemon cannot be reached: check that it runs and that this device is on its network"]);
  }
  const reasons = await response.json().then((answer) => answer.reasons, () => undefined);
  if (response.status === 401) watchers.forEach((watcher) => watcher());
  throw new Refused(response.status, Array.isArray(reasons) && reasons.length ? reasons : [`the daemon answered ${response.status}`]);
}

export const get = (path, options) => ask("GET", path, undefined, options);
export const post = (path, body, options) => ask("POST", path, body, options);
