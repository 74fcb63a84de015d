"""Tables of the planners: what missed targets need, plans beside IPOPT, and the time of `mppi`."""

from benchmarks.markdown import Read, markdown
from softarm.training.trajectory import needs as needed


def needs(read: Read) -> str:
    """Return the smallest change of each quantity that reaches each missed target."""
    return markdown(*needed.lines(read("needs")))


def planning(read: Read) -> str:
    """Return processor time and success of both planners from the middle of the rail."""
    found = read("planning")
    titles = {"softarm": "`softarm dev plan`", "ipopt": "CasADi with IPOPT, from an arm at rest"}
    rows = [(titles[name], str(found[name]["reached"]), f"{found[name]['cpu_s']:.1f}") for name in titles]
    return markdown((f"{found['targets']} targets", "reached", "processor time (s)"), rows)


def replanning(read: Read) -> str:
    """Return the times of `mppi` for a command, and its success."""
    found = read("replanning")
    rows = []
    for name, row in found["tests"].items():
        times = [
            " / ".join(f"{row[kind][part]:.1f}" for part in ("p50", "p99", "max")) for kind in ("wall_ms", "cpu_ms")
        ]
        rows.append((name, f"{row['reached']} of {row['flights']}", *times, f"{row['rounds']:.2f}"))
    return markdown(("flights", "reached", "wall time (ms)", "processor time (ms)", "rounds"), rows)


TABLES = {"needs": needs, "planning": planning, "replanning": replanning}
