// One request, with a time limit; what is refused comes as the daemon's own reasons.

export class Refused extends Error {
  // status: HTTP's; 0: no answer at all
  constructor(status, reasons) {
    super(reasons.join("; "));
    this.status = status;
    this.reasons = reasons;
  }
}

const watchers = new Set();
// Is told whenever the daemon no longer knows who asks.
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
    throw new Refused(0, [late ? `no answer within ${seconds} s` : "the daemon cannot be reached: is it running, and is this device on its network?"]);
  }
  const reasons = await response.json().then((told) => told.reasons, () => undefined);
  if (response.status === 401) watchers.forEach((watcher) => watcher());
  throw new Refused(response.status, Array.isArray(reasons) && reasons.length ? reasons : [`the daemon answered ${response.status}`]);
}

export const get = (path, options) => ask("GET", path, undefined, options);
export const post = (path, body, options) => ask("POST", path, body, options);
