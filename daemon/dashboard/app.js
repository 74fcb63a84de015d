// The live mode, from the stream; a lost connection is said and tried again.
const AGAIN_MS = 1000;
const shown = document.getElementById("mode");

async function follow() {
  const answer = await fetch("/api/ticket", { method: "POST" });
  if (!answer.ok) throw new Error((await answer.json()).detail);
  const { ticket } = await answer.json();
  const secure = location.protocol === "https:" ? "wss" : "ws";
  const stream = new WebSocket(`${secure}://${location.host}/api/stream?ticket=${ticket}`);
  stream.onmessage = ({ data }) => {
    const status = JSON.parse(data);
    shown.textContent = status.stalled ? "the control loop does not tick" : status.mode;
  };
  stream.onclose = () => retry("lost the connection");
}

function retry(why) {
  shown.textContent = `${why}; trying again`;
  setTimeout(() => follow().catch((error) => retry(error.message)), AGAIN_MS);
}

follow().catch((error) => retry(error.message));
