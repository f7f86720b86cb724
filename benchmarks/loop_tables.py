"""Tables of the loop benchmarks for docs/results.md and the README, from their reports alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Report = Mapping[str, Any]

# What a method is, as the tables call it.
_METHODS = {
    "paper": "`paper`",
    "fast": "`fast`",
    "fast_portable": "`fast`, SSE4.2 and POPCNT",
    "fast_no_popcnt": "`fast`, no POPCNT",
    "poselib": "PoseLib",
    "pnp": "PnP",
}
_CONDITIONS = {
    "default": "30 % wrong matches, 1 px, odometry 1 cm and 0.2° a keyframe",
    "half_noise": "0.5 px",
    "outliers_50": "50 % wrong matches",
    "outliers_60": "60 % wrong matches",
    "odometry_noise": "odometry 1.7 times as wrong",
    "short_baseline": "keyframes 5 to 15 cm apart, scene 5 to 15 m away",
    "forward": "rigs and loop along the optical axis",
    "pure_rotation": "rigs that only turn: no scale",
}
_SCENARIOS = {
    "redkitchen": "redkitchen: real images and odometry; all near pairs",
    "redkitchen_elsewhere": "redkitchen: pairs 1.5 m or 60° apart, with little in common",
    "elsewhere": "redkitchen with fr1_rpy, another building: none is right",
    "fr1_rpy": "fr1_rpy: real images, the camera only turns",
    "hall": "generated hall: what place recognition asks",
    "courtyard": "generated courtyard: what place recognition asks",
    "machine_hall": "generated machine hall, real odometry: what place recognition asks",
}
_SYNTHETIC = (
    "problems", "method", "right, of those not rejected", "rejected", "error, median",
    "error, 95 %", "mean NEES", "NEES > 22.5", "CPU time, median / p95",
)  # fmt: skip
_ACCURACY = (
    "attempts", "method", "accepted", "wrong", "error, median", "mean NEES", "analytic NEES",
    "NEES > 22.5", "CPU time, median / p95",
)  # fmt: skip
_TRAFFIC = (
    "run", "profile", "loops / candidates", "wrong", "time per loop", "time per candidate",
    "sent by a robot",
)  # fmt: skip


def synthetic_section(report: Report) -> str:
    """`loop_synthetic.py`: every condition by every method."""
    text = "\n## Loops of generated problems\n\n"
    text += (
        f"`benchmarks/loop_synthetic.py`: {report['trials']} problems of each kind, the same for"
        " all methods, one after the other on each; times are CPU times of one thread"
        f" ({report['isa']}), matching included. Right: within 0.3 m and 3°. `paper` is this"
        " project's implementation of the paper, not its public code. PoseLib's"
        " `estimate_generalized_relative_pose` is a peer: it gets the matches of `fast`, whose time"
        " counts, takes the rigs as rigid and has no covariance.\n\n"
    )
    rows = [
        [_CONDITIONS[name], _METHODS[method], *synthetic_cells(figures)]
        for name, methods in report["conditions"].items()
        for method, figures in methods.items()
    ]
    text += table(_SYNTHETIC, merged(rows))
    paper = report["conditions"].get("default", {}).get("paper")
    if paper is not None:
        matching = paper["stage_ms_mean"].get("matching", 0.0)
        text += (
            f"\n`paper` takes {paper['ms_median']:.0f} ms, of which {matching:.0f} ms are matching"
            " by OpenCV. Before it was written its parts, measured one by one on such problems,"
            " added up to 189 ms, 114 of them matching; `fast` is compared with what `paper` takes"
            " now.\n"
        )
    return text + (
        f"\n`fast` is {times(report['speedup_median'])} as fast as `paper` on the first kind,"
        f" {times(report['speedup_portable_median'])} with SSE4.2 and POPCNT alone"
        f"{older_cpu(report)}, {times(report['speedup_no_popcnt_median'])} without POPCNT, and"
        f" {times(report['speedup_geometry_only_median'])} without the matching of both (medians"
        " over the problems).\n"
    )


def older_cpu(report: Report) -> str:
    """What a processor without AVX2 makes of the portable speed-up."""
    speedup = report.get("speedup_portable_older_cpu_median")
    return "" if speedup is None else f" ({times(speedup)} where `paper` has no AVX2 either)"


def synthetic_cells(figures: Report) -> list[str]:
    """One line of the table."""
    return [
        percent(figures["success"]),
        stages(figures["rejected"]),
        pose_error(figures["t_err_median_m"], figures["r_err_median_deg"]),
        pose_error(figures["t_err_p95_m"], figures["r_err_p95_deg"]),
        number(figures["nees_mean"]),
        percent(figures["nees_over_22_5"]),
        milliseconds(figures["ms_median"], figures["ms_p95"]),
    ]


def accuracy_section(report: Report) -> str:
    """`loop_accuracy.py`: every scenario by every method, and the fine print."""
    text = "\n## Loops of images\n\n"
    text += (
        "`benchmarks/loop_accuracy.py`, as the paper's Table I: the same attempts by all methods,"
        " rigs and options as in the worker. NEES (6 would be honest) judges the covariance that a"
        " method gives: `paper` samples it, `fast` estimates it with the noise of its adjustment;"
        " *analytic* is the inverse Hessian of the latter alone. PnP is a baseline of this project:"
        " points triangulated with odometry from the candidate's rig, OpenCV's RANSAC; COVINS"
        " itself gets map points from the robots.\n\n"
    )
    found = [(name, report[name]) for name in _SCENARIOS if name in report]
    rows = [
        [f"{_SCENARIOS[name]} ({figures['jobs']})", _METHODS[method], *accuracy_cells(figures)]
        for name, methods in found
        for method, figures in methods.items()
    ]
    text += table(_ACCURACY, merged(rows)) + "\n"
    for name, compared in report["fast_over_paper"].items():
        loops = compared["accepted"]
        many = "" if loops is None else f"{loops:.1f} loops for each one of `paper`, "
        fast = times(compared["speedup_median"])
        text += f"- {name}: {many}{fast} as fast (median of {compared['jobs']} attempts of both).\n"
    for name, methods in found:
        rejected = "; ".join(
            f"{_METHODS[method]} {stages(figures['rejected'])}"
            for method, figures in methods.items()
        )
        text += f"- {name}, rejected: {rejected}.\n"
    return text + fine_print(report)


def fine_print(report: Report) -> str:
    """What a reader must know to judge the figures of the real recordings."""
    text = ""
    if "redkitchen" in report:
        fast = report["redkitchen"]["fast"]
        text += (
            "- redkitchen: wrong is off by more than 0.5 m or 10°. Its ground truth is good to 4 cm"
            " and 1.2° a pair, which NEES adds to the covariance; without that the mean of `fast`"
            f" is {number(fast['nees_mean_without_truth'])}, and of its inverse Hessian alone"
            f" {number(fast['nees_analytic_mean_without_truth'])}. One kitchen, a few metres: it"
            " says little about other places.\n"
        )
    if "fr1_rpy" in report:
        fast = report["fr1_rpy"]["fast"]
        text += (
            f"- fr1_rpy: of {fast['jobs']} attempts {fast['estimated']} reach estimation by `fast`;"
            f" {fast['accepted']} are accepted, {fast['within_nees_22_5']} of them within a NEES of"
            f" 22.5 and {fast['beyond_nees_22_5']} beyond. Its odometry is the truth plus stated"
            " drift. The camera turns at 1.3 rad/s (median) with a rolling shutter, which no method"
            " models.\n"
        )
    return text + "- Elsewhere wrong is off by more than 0.3 m or 8°.\n"


def accuracy_cells(figures: Report) -> list[str]:
    """One line of the table."""
    return [
        str(figures["accepted"]),
        str(figures["wrong"]),
        pose_error(figures["t_err_median_m"], figures["r_err_median_deg"]),
        number(figures["nees_mean"]),
        number(figures["nees_analytic_mean"]),
        percent(figures["nees_over_22_5"]),
        milliseconds(figures["ms_median"], figures["ms_p95"]),
    ]


def traffic_section(report: Report) -> str:
    """`runtime_traffic.py`: runs beside the paper's own figures, and time by stage."""
    text = "\n## Time and traffic\n\n"
    text += (
        "`benchmarks/runtime_traffic.py`, as the paper's Table III: lockstep runs with one worker;"
        " CPU times of one thread for a sample of the jobs of each run, mean ± standard deviation."
        " The last lines are the paper's own figures, of EuRoC with five robots on a laptop of"
        " 2015: other images, other odometry, another machine; they tell the magnitude.\n\n"
    )
    runs = [
        (name, profile, figures)
        for name, profiles in report["scenarios"].items()
        for profile, figures in profiles.items()
    ]
    rows = [[name, _METHODS[profile], *traffic_cells(figures)] for name, profile, figures in runs]
    rows += [[f"{name}, as published", "", *traffic_cells(figures)]
             for name, figures in report["published"].items()]  # fmt: skip
    text += table(_TRAFFIC, merged(rows)) + "\nMean time of a candidate by stage:\n\n"
    names = list(dict.fromkeys(s for *_, f in runs for s in f["attempt_stage_ms_mean"]))
    lines = [
        [name, _METHODS[profile]]
        + [stage_time(figures["attempt_stage_ms_mean"].get(stage)) for stage in names]
        for name, profile, figures in runs
    ]
    return text + table(("run", "profile", *names), merged(lines))


def traffic_cells(figures: Report) -> list[str]:
    """One line of the table; the paper's own figures have no candidates."""
    candidates = figures.get("candidates")
    return [
        f"{figures['loops']}" + ("" if candidates is None else f" / {candidates}"),
        "-" if figures.get("wrong") is None else str(figures["wrong"]),
        spread(figures.get("loop_ms_mean"), figures.get("loop_ms_std")),
        spread(figures.get("attempt_ms_mean"), figures.get("attempt_ms_std")),
        f"{figures['kB_per_s_per_agent']:.0f} kB/s",
    ]


def brief(synthetic: Report, accuracy: Report) -> str:
    """The README's table: one line a figure, `paper` beside `fast` beside a peer."""
    default = synthetic["conditions"]["default"]
    rows = [
        ["generated problems, 30 % wrong matches: error, median"]
        + [pose_error(m["t_err_median_m"], m["r_err_median_deg"]) for m in of(default, "poselib")],
        ["the same: mean NEES (6 would be honest)"]
        + [number(m["nees_mean"]) for m in of(default, "poselib")],
        ["the same: CPU time, median / p95"]
        + [milliseconds(m["ms_median"], m["ms_p95"]) for m in of(default, "poselib")],
    ]
    for name in ("redkitchen", "hall"):
        if name not in accuracy:
            continue
        found = of(accuracy[name], "pnp")
        rows += [
            [f"{_SCENARIOS[name]}: accepted (wrong) of attempts"]
            + [f"{m['accepted']} ({m['wrong']}) of {m['jobs']}" for m in found],
            ["the same: error, median"]
            + [pose_error(m["t_err_median_m"], m["r_err_median_deg"]) for m in found],
            ["the same: mean NEES"] + [number(m["nees_mean"]) for m in found],
            ["the same: CPU time, median / p95"]
            + [milliseconds(m["ms_median"], m["ms_p95"]) for m in found],
        ]
    return table(("loops", "`paper`", "`fast` (default)", "PoseLib / PnP"), rows)


def of(methods: Report, peer: str) -> list[Report]:
    """The paper's figures, those of fast and those of a peer."""
    return [methods[name] for name in ("paper", "fast", peer)]


def merged(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """The same rows; a first cell that repeats the one above is left empty."""
    firsts = [row[0] for row in rows]
    return [
        ["" if i and row[0] == firsts[i - 1] else row[0], *row[1:]] for i, row in enumerate(rows)
    ]


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def pose_error(metres: float | None, degrees: float | None) -> str:
    """Errors of a pose."""
    return "-" if metres is None or degrees is None else f"{metres:.3f} m, {degrees:.2f}°"


def percent(share: float | None) -> str:
    """A share."""
    return "-" if share is None else f"{100 * share:.1f} %"


def number(value: float | None) -> str:
    """A NEES."""
    return "-" if value is None else f"{value:.1f}"


def times(factor: float | None) -> str:
    """How many times."""
    return "-" if factor is None else f"{factor:.1f} times"


def milliseconds(median: float | None, p95: float | None) -> str:
    """Median and 95 % quantile."""
    return "-" if median is None or p95 is None else f"{median:.1f} / {p95:.1f} ms"


def spread(mean: float | None, deviation: float | None) -> str:
    """Mean and standard deviation."""
    return "-" if mean is None or deviation is None else f"{mean:.1f} ± {deviation:.1f} ms"


def stage_time(mean: float | None) -> str:
    """The time of a stage; the other profile's stages are not there."""
    return "" if mean is None else f"{mean:.2f} ms"


def stages(rejected: Mapping[str, int]) -> str:
    """How many were rejected at which stage."""
    return ", ".join(f"{stage} {count}" for stage, count in rejected.items()) or "none"
