"""Tables of the pages, from stored results to Markdown, with targets and the paper's figures next to them."""

from collections.abc import Callable, Mapping
from typing import Any

from benchmarks import diagnosis_tables, planning_tables
from benchmarks.markdown import Read, markdown
from softarm.evaluation import faults as worst
from softarm.evaluation.entries import CEILING
from softarm.evaluation.table import HARDWARE
from softarm.schemas.robot import CONTROL_PERIOD_S

BRIDGED = ("bridging", "bridging-payload")
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
    speed = read("grid-speed")["real_time_factor"]
    rows = []
    for policy, title in _GRID.items():
        found = read(f"grid-{policy}")
        shares = [f"{_percent(found['success'][part])} %" for part in ("in_range", "above", "all")]
        places = [f"{found['max_tip_z_m']:.2f} m", f"{found['max_cart_m']:.3f} m"]
        rows.append([title, *shares, *places, speed.get(policy, "")])
    for (policy, found), tip in zip(HARDWARE.items(), ("", "", "0.56 m"), strict=True):
        shares = [f"{100 * found[part]:.0f} %" if part in found else "" for part in ("in_range", "above", "all")]
        rows.append([f"{policy}, its hardware", *shares, tip, "", ""])
    return markdown(("policy", "z <= 0.70 m", "z > 0.70 m", "all", "highest tip", "farthest cart", "speed"), rows)


# Column of `softarm evaluate --all` -> title, trials per seed.
_TESTS = {
    "in_range": ("<= 0.70 m", 108),
    "above": ("> 0.70 m", 54),
    "all": ("all 54", 162),
    "swinging": ("mid-swing", 162),
    "shelf": ("shelf, 12", 12),
    "shelf_random": ("shelf, random", 500),
    "held_back": ("held-back", 162),
    "held_back_changed": ("held-back, changed", 162),
    "held_back_shelf": ("held-back, shelf", 12),
}
_ROWS = ("reach", "reach-wide", "reach-robust", "shelf", "mppi", "trajectory", "pid", CEILING)


def all_tests(read: Read) -> str:
    """Return all policies at all tests, the trained ones over their seeds."""
    stored = [read(name) for name in ("all-tests-trained", "all-tests-mppi", "all-tests-others")]
    figures = {policy: row for each in stored for policy, row in each["policies"].items()}
    seeds = {policy: known for each in stored for policy, known in each["seeds"].items()}
    rows = []
    for policy in _ROWS:
        title = "ceiling (open-loop search)" if policy == CEILING else f"`{policy}`"
        cells = [cell(figures[policy].get(column), trials=trials) for column, (_, trials) in _TESTS.items()]
        rows.append([title, str(len(seeds[policy]) or ""), *cells])
    for policy, shares in HARDWARE.items():
        cells = [f"{100 * shares[column]:.0f}" if column in shares else "" for column in _TESTS]
        rows.append([f"{policy}, its hardware", "", *cells])
    return markdown(("policy", "seeds", *(title for title, _ in _TESTS.values())), rows)


def sweep(read: Read) -> str:
    """Return the results of five seeds of each shipped policy's training."""
    columns = ("in_range", "above", "all", "shelf", "shelf_random")
    rows = []
    for name, run in read("sweep")["runs"].items():
        cells = [f"{cell(run[column])} %" if column in run else "" for column in columns]
        rows.append([f"`{name}`", f"{run['frames'] / 1e6:.0f} M", f"{run['seconds']:.0f}", *cells])
    return markdown(
        ("run", "frames", "seconds on one core", "in range", "above", "all", "shelf, 12", "shelf, 500"), rows
    )


def time_to_level(read: Read) -> str:
    """Return the time of each seed to the paper's level."""
    found = read("training")
    seconds, frames = found["seconds_to_seed_level"], found["frames_to_seed_level"]
    head = ("", *(f"seed {k}" if k == 1 else str(k) for k in range(1, 1 + len(seconds))), "aim")
    return markdown(
        head,
        [
            ["seconds", *("never" if value is None else f"{value:.0f}" for value in seconds), "60 for four of five"],
            ["million frames", *("" if value is None else f"{value / 1e6:.1f}" for value in frames), ""],
        ],
    )


def rl_games(read: Read) -> str:
    """Return the learning curve of rl_games."""
    curve = read("rl-games")["seconds, frames, in range, above, all"]
    shares = (" / ".join(f"{100 * share:.0f}" for share in point[2:]) for point in curve)
    return markdown(
        ("seconds", *(f"{point[0]:.0f}" for point in curve)),
        [
            ["million frames", *(f"{point[1] / 1e6:.2f}" for point in curve)],
            ["in range / above / all, %", *shares],
        ],
    )


def faults(read: Read) -> str:
    """Return the success of policies with one fault of the independent robot at a time."""
    found = {fault: of for fault, of in read("faults").items() if fault != "about"}
    head, rows = worst.lines(found)
    return markdown(head, rows)


_ROBOTS = {
    "all": "all 54",
    "held_back": "held-back",
    "held_back_payload": "50 g at the tip",
    "held_back_slow": "slow regulator",
    "held_back_late": "late rail (50 ms)",
    "held_back_changed": "all three",
    "held_back_later": "rail 90 ms late",
    "held_back_weak": "drive at 3 m/s^2",
}


def differ(read: Read) -> str:
    """Return policies over seeds on robots with faults."""
    policies = read("differ")["policies"]
    rows = [[f"`{policy}`", *(cell(figures.get(column)) for column in _ROBOTS)] for policy, figures in policies.items()]
    return markdown(("policy", *_ROBOTS.values()), rows)


# Run of benchmarks/ablation.yaml -> description, the paper's hardware (Table 1; of 12 trials, percent).
_ABLATION = {
    "full": ("everything (action noise, LSTM after the MLP)", "92"),
    "no-pressure-lag": ("no pressure lag", "0"),
    "no-acceleration-limit": ("no acceleration limit of the cart", "8"),
    "no-delay": ("no delay", "0"),
    "no-finite-difference": ("true velocities instead of differences", "0"),
    "no-finite-difference-long": ("the same, 10 M frames", ""),
    "observations": ("noise on observations instead", "25"),
    "dynamics": ("randomised dynamics instead", "25"),
    "no-randomisation": ("no randomisation", "17"),
    "mlp-only": ("MLP alone", "0"),
    "lstm-before-mlp": ("LSTM before the MLP", "0"),
    "lstm-before-mlp-long": ("the same, 10 M frames", ""),
    "no-muscle": ("no muscle", "0"),
}
_MATRIX = {
    "shelf": "shelf, 12",
    "shelf_random": "shelf, 500",
    "shelf_random@no-pressure-lag": "500 without pressure lag",
    "shelf_random@no-acceleration-limit": "500 without acceleration limit",
    "shelf_random@no-delay": "500 without delay",
    "held_back_shelf": "independent robot, 12",
}


def ablation(read: Read) -> str:
    """Return the paper's Table 1: training with one ingredient changed, at the shelf."""
    found = read("ablation")["policies"]
    rows = [
        [title, *(cell(found[run][column], digits=0) for column in _MATRIX), hardware]
        for run, (title, hardware) in _ABLATION.items()
    ]
    return markdown(("trained with", *_MATRIX.values(), "the paper's hardware"), rows)


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


def first_use(read: Read) -> str:
    """Return a new user's first minutes."""
    rows = [
        [each["step"], f"{each['after_s']:.0f} s", f"{each['aim_s']:.0f} s" if each["aim_s"] else ""]
        for each in read("first-use")["steps"]
    ]
    return markdown(("", "after", "aim"), rows)


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
    """Return flights with dropouts of motion capture, by reaction."""
    ways = {"stopped": "none", "held": "last frame held", "bridged": "bridged", "default": "as configured by default"}
    cells: dict[tuple[str, int], dict[str, str]] = {}
    for flown in (each for name in BRIDGED for each in read(name)["flights"]):
        cells.setdefault((flown["body"], flown["dropout_ms"]), {})[flown["way"]] = "{reached}, {stopped}".format(
            **flown
        )
    rows = [
        [body, f"{ms} ms" if ms else "none", *(by_way[way] for way in ways)] for (body, ms), by_way in cells.items()
    ]
    return markdown(("body", "drop-outs of", *(f"{way}: reached, stopped" for way in ways.values())), rows)


def estimates(read: Read) -> str:
    """Return the error of the estimated tip after ticks without a frame."""
    bodies: dict[str, dict[str, list[float]]] = {}
    for name in BRIDGED:
        bodies |= read(name)["tip_rms_m"]
    rows = [
        [body, method, *(f"{1e3 * off_m:.1f}" for off_m in rms_m)]
        for body, methods in bodies.items()
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
    seconds = dict(zip(map(str, trained["robots"]), trained["seconds_to_seed_level"], strict=True))
    robots = sorted({int(each) for row in (*speeds.values(), seconds) for each in row})

    def line(name: str, row: Mapping[str, float], digits: int, unit: float = 1.0) -> list[str]:
        return [name, *(f"{row[str(k)] / unit:,.{digits}f}" if str(k) in row else "" for k in robots)]

    *simulated, training = speeds.items()
    rows = [line(*each, 0, 1e6) for each in simulated]
    rows += [line(*training, 1, 1e6), line("seconds to 94/50/80 %, seed 1", seconds, 1)]
    return markdown(("robots", *(f"{k:,}" for k in robots)), rows)


def matrix(read: Read) -> str:
    """Return a row for each part and fault, with the arm's reaction in each phase."""
    cells: dict[tuple[str, str], dict[str, Any]] = {}
    for found in read("matrix")["cells"]:
        cells.setdefault((found["who"], found["fault"]), {})[found["phase"]] = found
    rows = []
    for (part, fault), phases in cells.items():
        events = dict.fromkeys(f"`{name}`" for found in phases.values() for name in found["logged"])
        reactions = [f"{phase}: {_reaction(found)}" for phase, found in phases.items()]
        rows.append([part, f"`{fault}`", "; ".join(reactions), ", ".join(events)])
    return markdown(("part", "fault", "the arm, by phase", "events"), rows)


def _reaction(found: Mapping[str, Any]) -> str:
    if found["wrong"]:
        return "**" + "; ".join(found["wrong"]) + "**"
    if found["phase"] == "open":
        return "not armed" if found["stopped"] and found["causes"] else "can be armed"
    if not found["stopped"]:
        return "flies"
    times = [found["braked_ms"], found["vented_ms"]]
    return "stops" if None in times else f"safe in {max(times):.0f} ms"


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


TABLES: dict[str, Callable[[Read], str]] = {
    "grid": grid,
    "all-tests": all_tests,
    "sweep": sweep,
    "time-to-level": time_to_level,
    "rl-games": rl_games,
    "faults": faults,
    "differ": differ,
    "ablation": ablation,
    "loop": loop,
    "viewers": viewers,
    "first-use": first_use,
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
    **diagnosis_tables.TABLES,
    **planning_tables.TABLES,
}
