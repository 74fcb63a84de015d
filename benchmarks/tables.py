"""Tables of the pages, from stored results to Markdown, with targets and the paper's figures next to them."""

from collections.abc import Callable, Mapping
from itertools import groupby
from typing import Any

from benchmarks.diagnosis_tables import blind, blind_methods, real_arm, servos, servos_held_out
from benchmarks.markdown import Read, markdown
from softarm.evaluation import faults as worst
from softarm.evaluation.closing.outcomes import TITLES
from softarm.evaluation.entries import CEILING
from softarm.evaluation.table import HARDWARE
from softarm.schemas.robot import CONTROL_PERIOD_S
from softarm.training.trajectory import ceiling as needed

NEAR = 0.03  # distance of a success to the level without the fault, at most, that counts as back
_SPREAD = "{p50:.0f} / {p99:.0f} / {max:.0f}"
Figure = Mapping[str, Any] | None  # mean, spread, refused: softarm.evaluation.table.Figure


def _percent(share: float, digits: int = 1) -> str:
    """Return a share in percent; exactly zero is a plain 0."""
    return f"{100 * share:.{digits}f}" if share else "0"


def cell(figure: Figure, digits: int = 1, trials: int | None = None) -> str:
    """Return mean and spread over seeds in percent; with `trials`, also how many of one seed were refused."""
    if figure is None:
        return ""
    if figure["spread"] is not None:
        return f"{100 * figure['mean']:.{digits}f} +- {100 * figure['spread']:.{digits}f}"
    refused = figure.get("refused", 0)
    if refused == 1:
        return "-"
    refusals = f" (refused {round(refused * trials)} of {trials})" if refused and trials else ""
    return _percent(figure["mean"], digits) + refusals


_GRID = {
    "reach": "`reach` (trained on z 0.55 to 0.70)",
    "reach-wide": "`reach-wide` (trained on z 0.54 to 0.80)",
    "reach-robust": "`reach-robust` (as `reach-wide`, on robots that differ)",
    "trajectory": "`trajectory` (planned, tracked: [trajectory.md](../training/trajectory.md))",
    "mppi": "`mppi` (replans at 30 Hz)",
    "pid": "`pid` (the paper's gains)",
}


def grid(read: Read) -> str:
    """Return each shipped policy at the paper's 54 targets, next to the paper's robot."""
    rows = []
    for policy, title in _GRID.items():
        found = read(f"grid-{policy}")
        shares = [f"{_percent(found['success'][part])} %" for part in ("in_range", "above", "all")]
        places = [f"{found['max_tip_z_m']:.2f} m", f"{found['max_cart_m']:.3f} m"]
        rows.append([title, *shares, *places, f"{found['real_time_factor']:.0f}"])
    for (policy, found), tip in zip(HARDWARE.items(), ("", "", "0.56 m"), strict=True):
        shares = [f"{100 * found[part]:.0f} %" if part in found else "" for part in ("in_range", "above", "all")]
        rows.append([f"{policy}, its hardware", *shares, tip, "", ""])
    return markdown(
        ("policy", "z <= 0.70 m", "z > 0.70 m", "all", "highest tip", "farthest cart", "times real time"), rows
    )


# Column of `softarm evaluate --all` -> title, trials per seed.
_TESTS = {
    "in_range": ("<= 0.70 m", 108),
    "above": ("> 0.70 m", 54),
    "all": ("all 54", 162),
    "swinging": ("mid-swing", 162),
    "shelf": ("shelf, 12", 12),
    "shelf_random": ("shelf, random", 500),
    "held_back": ("independent robot", 162),
    "held_back_changed": ("independent, all three", 162),
    "held_back_later": ("independent, rail 90 ms late", 162),
    "held_back_weak": ("independent, drive at 3 m/s^2", 162),
    "held_back_shelf": ("independent, shelf", 12),
}
_ROWS = ("reach", "reach-wide", "reach-robust", "shelf", "mppi", "trajectory", "pid", CEILING)


def all_tests(read: Read) -> str:
    """Return all policies at all tests, the trained ones over their seeds."""
    stored = read("all-tests")
    figures, seeds = stored["policies"], stored["seeds"]
    rows = []
    for policy in _ROWS:
        title = "ceiling (open-loop search)" if policy == CEILING else f"`{policy}`"
        cells = [cell(figures[policy].get(column), trials=trials) for column, (_, trials) in _TESTS.items()]
        rows.append([title, str(len(seeds[policy]) or ""), *cells])
    return markdown(("policy", "seeds", *(title for title, _ in _TESTS.values())), rows)


def time_to_level(read: Read) -> str:
    """Return the time of each seed to the paper's level, with the paper's network and a small one."""
    networks, rows = {"training": ("384,197 weights", "20"), "training-small": ("15,581 weights", "8")}, []
    for name, (network, aim) in networks.items():
        found = read(name)
        seconds, frames = found["seconds_to_seed_level"], found["frames_to_seed_level"]
        times = ("never" if value is None else f"{value:.0f}" for value in seconds)
        rows.append([f"{network}: seconds", *times, f"{aim} for four of five"])
        rows.append(["million frames", *("" if value is None else f"{value / 1e6:.1f}" for value in frames), ""])
    head = ("", *(f"seed {k}" if k == 1 else str(k) for k in range(1, 1 + len(seconds))), "aim")
    return markdown(head, rows)


def faults(read: Read) -> str:
    """Return the success of policies with one fault of the independent robot at a time."""
    found = {fault: of for fault, of in read("faults").items() if fault != "about"}
    head, rows = worst.lines(found)
    none = next(cells for name, *cells in rows if name == "none")
    differ = [row for row in rows if row[0] == "none" or list(row[1:]) != none]
    same = [f"{len(rows) - len(differ)} others", *none]
    return markdown(head, [*differ[:-1], same, differ[-1]])


_LOOP = {
    "compute_ms": ("compute", "1"),
    "lateness_ms": ("lateness", "1"),
    "bare_loop_lateness_ms": ("lateness of the bare loop", ""),
    "sensor_to_command_ms": ("sensor to command", ""),
}


def loop(read: Read) -> str:
    """Return the punctuality of the control loop."""
    found = read("loop")
    conditions = [found["idle"], found["hammered"]]
    spread = "{p50:.2f} / {p99:.2f} / {p999:.2f} / {max:.2f}"
    rows = [[title, *(spread.format(**at[key]) for at in conditions), aim] for key, (title, aim) in _LOOP.items()]
    rows.append(["missed ticks", *(f"{at['missed_ticks']} of {at['ticks']}" for at in conditions), "0"])
    return markdown(("p50 / p99 / p99.9 / max (ms)", "idle", "hammered", "aim (p99.9)"), rows)


def viewers(read: Read) -> str:
    """Return the cost of ten viewers."""
    found = read("viewers")
    sides = [found["alone"], found["viewed"]]
    keys = ("lateness_ms", "bare_loop_lateness_ms", "compute_ms")
    rows = [[_LOOP[key][0], *("{p50:.2f} / {p99:.2f} / {max:.2f}".format(**at[key]) for at in sides)] for key in keys]
    rows.append(["missed ticks", *(f"{side['missed_ticks']} of {side['ticks']}" for side in sides)])
    rows.append(["daemon, of a core", *(f"{100 * side['daemon_cpu']:.1f} %" for side in sides)])
    return markdown(("p50 / p99 / max (ms)", "no viewer", f"{found['viewers']} watch"), rows)


def stop(read: Read) -> str:
    """Return how soon a stop is answered under attack."""
    rows = []
    for attack, ways in read("stop")["answer_ms"].items():
        cells = [_answered(ways[way]) for way in ("stop", "api")]
        unanswered, asked = (sum(ways[way][key] for way in ("stop", "api")) for key in ("unanswered", "asked"))
        rows.append([attack, *cells, f"{unanswered} of {asked}"])
    return markdown(("p50 / p99 / max (ms), under", "stop port", "REST", "unanswered"), rows)


def _answered(found: Mapping[str, Any]) -> str:
    return "none" if found["p50"] is None else _SPREAD.format(**found)


def bridging(read: Read) -> str:
    """Return flights with dropouts of motion capture, by reaction; neighbours with the same counts share a row."""
    ways = {"stopped": "none", "held": "last frame held", "bridged": "bridged", "default": "as configured by default"}
    cells: dict[tuple[str, int], dict[str, str]] = {}
    for flown in read("bridging")["flights"]:
        counted = f"{flown['reached']}, {flown['stopped']}"
        cells.setdefault((flown["body"], flown["dropout_ms"]), {})[flown["way"]] = counted
    rows = []
    for (body, counts), same in groupby(cells, lambda key: (key[0], [cells[key][way] for way in ways])):
        lengths = [f"{ms} ms" if ms else "none" for _, ms in same]
        rows.append([body, " to ".join((lengths[0], *lengths[1:][-1:])), *counts])
    return markdown(("body", "drop-outs of", *(f"{way}: reached, stopped" for way in ways.values())), rows)


def estimates(read: Read) -> str:
    """Return the error of the estimated tip after ticks without a frame."""
    rows = [
        [body, method, *(f"{1e3 * off_m:.1f}" for off_m in rms_m)]
        for body, methods in read("bridging")["tip_rms_m"].items()
        for method, rms_m in methods.items()
    ]
    ticks = [f"{1e3 * CONTROL_PERIOD_S * tick:.0f} ms" for tick in range(1, len(rows[0]) - 1)]
    return markdown(("body", "estimate: tip off by (RMS, mm) after", *ticks), rows)


_BODIES = {
    "simulated": "our simulator, lockstep",
    "reality": "`reality/`, lockstep",
    "outside": "`validation/outside/`, over the wires",
}


def chained(read: Read) -> str:
    """Return goals without rest, by body."""
    rows = []
    for body, title in _BODIES.items():
        found = read(f"chained-{body}")
        reached = ("{reached} of {goals}", "{trained_reached} of {trained_goals}")
        cart = (f"{1e3 * found['max_cart_m']:.0f} mm", str(found["excursions"]), str(found["crashes"]))
        missed = "{late_steps} of {steps}, {missed_ticks}".format(**found["timing"]) if "timing" in found else ""
        rows.append(
            [title, *(each.format(**found) for each in reached), *cart, str(sum(found["stops"].values())), missed]
        )
    head = ("body", "reached", "where it was trained", "farthest cart", "beyond 255 mm", "at the end", "stops unasked")
    return markdown((*head, "late steps, missed ticks"), rows)


_DEAD = {
    "stop_received_ms": "last command (ms)",
    "vented_ms": "valve open (ms)",
    "travel_mm": "travel (mm)",
    "farthest_mm": "from the middle (mm)",
}


def dead_daemon(read: Read) -> str:
    """Return how far the cart moves when a process ends or freezes."""
    rows = [
        [name, *(_SPREAD.format(**found[key]) for key in _DEAD), "{crashes} of {trials}".format(**found)]
        for name, found in read("dead-daemon")["cases"].items()
    ]
    return markdown(("p50 / p99 / max", *_DEAD.values(), "at the end stop"), rows)


def simulator(read: Read) -> str:
    """Return speed and error next to MuJoCo."""
    found = read("simulator")
    ours, theirs = (
        f"{found[key]['mean']:.2f} / {found[key]['max']:.2f} mm" for key in ("tip_error_mm", "mujoco_tip_error_mm")
    )
    fast, slow = found["control_steps_per_core_s"], found["mujoco_control_steps_per_core_s"]
    version = found["mujoco_version"].rpartition(".")[0]
    return markdown(
        ("", "step rate", "control steps per core and second", "tip error after 3 s, mean / max"),
        [
            ["softarm", f"{found['step_rate_hz']:.0f} Hz", f"{fast / 1e6:.1f} M", ours],
            [f"MuJoCo {version}", f"{found['mujoco_step_rate_hz']:.0f} Hz", f"{slow / 1e3:.1f} k", theirs],
            ["ratio", "", f"{found['ratio']:.0f} (aim 250)", ""],
        ],
    )


def card(read: Read) -> str:
    """Return speeds on a graphics card for each number of robots, in million control steps a second."""
    found, trained = read("card"), read("training-card")
    speeds: dict[str, Mapping[str, float]] = {
        "simulator, the paper's effects": found["simulator_steps_per_s"]["seed"],
        "simulator, every effect": found["simulator_steps_per_s"]["every"],
        "environment of `reach`": found["environment_steps_per_s"],
        "training, the paper's network": found["training_steps_per_s"],
    }
    robots = sorted({int(each) for row in speeds.values() for each in row})

    def line(name: str, row: Mapping[str, float], digits: int) -> list[str]:
        return [name, *(f"{row[str(k)] / 1e6:,.{digits}f}" if str(k) in row else "" for k in robots)]

    *simulated, training = speeds.items()
    rows = [line(*each, 0) for each in simulated] + [line(*training, 1)]
    seconds = ", ".join("never" if each is None else f"{each:.0f}" for each in trained["seconds_to_seed_level"])
    rows.append(["seconds to 94/50/80 %, seeds 1 to 5", seconds, *[""] * (len(robots) - 1)])
    return markdown(("robots", *(f"{k:,}" for k in robots)), rows)


def matrix(read: Read) -> str:
    """Return a row for each part and fault, with the arm's reaction in each phase."""
    cells: dict[tuple[str, str], dict[str, Any]] = {}
    columns = "open", "read", "write", "close"
    for found in read("matrix")["cells"]:
        phase = found["phase"] if found["phase"] in columns else "read"  # a policy's step, a process
        cells.setdefault((found["who"], found["fault"]), {})[phase] = found
    rows = []
    for (part, fault), phases in cells.items():
        events = dict.fromkeys(f"`{name}`" for found in phases.values() for name in found["logged"])
        reactions = [_reaction(phases[name]) if name in phases else "" for name in columns]
        rows.append([part, f"`{fault}`", *reactions, ", ".join(events)])
    return markdown(("part", "fault", *columns, "events"), rows)


def _reaction(found: Mapping[str, Any]) -> str:
    if found["wrong"]:
        return "**" + "; ".join(found["wrong"]) + "**"
    if found["phase"] == "open":
        return "not armed" if found["stopped"] and found["causes"] else "can be armed"
    if not found["stopped"]:
        return "flies"
    times = [found["braked_ms"], found["vented_ms"]]
    return "stops" if None in times else f"{max(times):.0f} ms"


def adversary(read: Read) -> str:
    """Return how far malicious policies bring the cart, past the law alone and past the whole tick."""
    rows = []
    for name, what in (("adversary", "the law"), ("adversary-tick", "the whole tick")):
        found = read(name)
        kinds = [f"{1e3 * farthest_m:.0f}" if farthest_m else "" for farthest_m in found["farthest_m"].values()]
        beyond = f"{1e3 * max(world['beyond_m'] for world in found['worst']):.1f} mm"
        counts = [str(found[key]) for key in ("worlds_beyond_margin", "worlds_at_hard_limit")]
        rows.append([what, str(found["worlds"]), f"{found['robot_ticks']:,}", *kinds, beyond, *counts])
    kinds = [f"{kind} (mm)" for kind in read("adversary")["farthest_m"]]
    head = ("past", "robots", "ticks", *kinds, "beyond 250 mm at most", "robots farther than 5 mm", "at the end")
    return markdown(head, rows)


def adversary_cost(read: Read) -> str:
    """Return the share of the paper's targets reached where the limits fit the robot."""
    found = read("adversary-cost")["cost"]
    policies = [key for key in found["as it is"] if key not in COUNTED]
    rows = []
    for world, figures in found.items():
        counted = [f"{figures[key]:.2f}" for key in COUNTED]
        rows.append([world, *counted, *(f"{100 * figures[policy]:.0f} %" for policy in policies)])
    return markdown(("robot", *(f"`{key}`" for key in COUNTED), *(f"`{policy}`" for policy in policies)), rows)


COUNTED = ("braking_m_s2", "drag_m_s")


def rail_limits(read: Read) -> str:
    """Return measured limits next to the truth, and how far an attack comes with them."""
    rows = []
    for found in read("limits")["rows"]:
        robot, measured = found["robot"], found["measured"]
        bounds = ["-" if each is None else f"{each['value']:.3g} ({each['events']})" for each in measured.values()]
        late = f"{1e3 * (robot['latency_s'] + robot['age_s']):.0f} ms"
        truth = (robot["body"], f"{robot['ramp_m_s2']:g}", f"{1e3 * robot['payload_kg']:.0f} g", late)
        rows.append([*truth, *bounds, f"{1e3 * found['farthest_m']:.0f} mm"])
    keys = [f"`{key}`" for key in read("limits")["rows"][0]["measured"]]
    return markdown(("body", "ramp", "payload", "truly late by", *keys, "cart at most"), rows)


def needs(read: Read) -> str:
    """Return the smallest change of each quantity that reaches each missed target."""
    found = read("needs")
    useful, useless = dict[str, Any](), list[str]()
    for name, (unit, now, most) in found["quantities"].items():
        if any(row["values"][name] is not None for row in found["rows"]):
            useful[name] = unit, now, most
        else:
            useless.append(f"- {name} ({now:g} to {most:g} {unit})\n")
    table = markdown(*needed.lines({**found, "quantities": useful}))
    return f"{table}\nNo target comes into reach by\n\n{''.join(useless)}"


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


def closing(read: Read) -> str:
    """Each fault of the independent robot: percent and stops of each way, and whether one returns to the level."""
    found, rows = read("closing"), []
    for case, summary in found["cases"].items():
        ways = summary["ways"]
        cells = [_way(ways[name]) if name in ways else "" for name in TITLES]
        back = any(_reached(way) >= found["level"] - NEAR and not _stops(way) for way in ways.values())
        rows.append([f"`{case}`", *cells, "yes" if back else "no", summary["fly"]])
    near = f"within {100 * NEAR:.0f} of {100 * found['level']:.0f}"
    return markdown(("fault", *TITLES.values(), near, "advice"), rows)


def _way(way: Mapping[str, Any]) -> str:
    stops = _stops(way)
    return f"{100 * _reached(way):.0f}{f', {stops} stops' if stops else ''}"


def _reached(way: Mapping[str, Any]) -> float:
    parts = (way["rest"], way["swinging"])
    return float(sum(part["reached"] for part in parts) / sum(part["flights"] for part in parts))


def _stops(way: Mapping[str, Any]) -> int:
    return sum(sum(way[manner]["stops"].values()) for manner in ("rest", "swinging"))


TABLES: dict[str, Callable[[Read], str]] = {
    "grid": grid,
    "all-tests": all_tests,
    "time-to-level": time_to_level,
    "faults": faults,
    "loop": loop,
    "viewers": viewers,
    "stop": stop,
    "bridging": bridging,
    "estimates": estimates,
    "chained": chained,
    "dead-daemon": dead_daemon,
    "matrix": matrix,
    "adversary": adversary,
    "adversary-cost": adversary_cost,
    "limits": rail_limits,
    "simulator": simulator,
    "card": card,
    "closing": closing,
    "needs": needs,
    "planning": planning,
    "real-arm": real_arm,
    "replanning": replanning,
    "blind": blind,
    "blind-methods": blind_methods,
    "servos": servos,
    "servos-held-out": servos_held_out,
}
