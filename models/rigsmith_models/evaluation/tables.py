"""From measured characters to tables: means with bootstrap intervals, and paired differences to every baseline.

All intervals are 95 %, by resampling characters (``metrics.bootstrap_interval``). A figure that a character lacks (a mirror
error without a mirror plane, a baseline without its file) leaves that character out of that figure.
"""

import numpy as np

from . import metrics

# Stage -> the systems, ours first; and the figures: name, heading, factor, decimals, whether less is better.
SYSTEMS = {
    "joints": ("rigsmith", "nearest_rig", "medial_points"),
    "body": ("rigsmith",),
    "tree": ("rigsmith", "shortest_tree"),
    "root": ("rigsmith", "central_joint"),
    "skin": ("auto", "heter_skin_net", "rignet", "geodesic_heat", "geodesic_voxel", "blender_heat", "inverse_distance", "closest_bone"),
}
FIGURES = {
    "joints": (
        ("cd_j2j", "CD-J2J %", 100, 2, True), ("cd_j2b", "CD-J2B %", 100, 2, True), ("cd_b2b", "CD-B2B %", 100, 2, True),
        ("iou", "IoU", 1, 3, False), ("precision", "precision", 1, 3, False), ("recall", "recall", 1, 3, False),
        ("tree_edit", "tree edit", 1, 1, True),
    ),
    "body": (
        ("cd_j2j", "CD-J2J %", 100, 2, True), ("iou", "IoU", 1, 3, False), ("precision", "precision", 1, 3, False),
        ("recall", "recall", 1, 3, False), ("joint_ratio", "joints / reference", 1, 2, False),
    ),
    "tree": (("tree_edit", "tree edit", 1, 2, True), ("bones_found", "bones found", 1, 3, False)),
    "root": (("accuracy", "accuracy", 1, 3, False), ("near", "within .05", 1, 3, False)),
    "skin": (
        ("l1", "L1", 1, 3, True), ("precision", "precision", 1, 3, False), ("recall", "recall", 1, 3, False),
        ("posed_mean", "posed mean %", 100, 2, True), ("posed_max", "posed max %", 100, 2, True),
    ),
}
MULTIPLIED = tuple(
    (f"{name}{suffix}", f"{name} × {multiplier}", 1, 3, False)
    for suffix, multiplier in (("_half", "½"), ("_wide", "1½")) for name in ("IoU".lower(), "precision", "recall"))
TITLES = {
    "joints": "Joints and skeleton, as the program gives them",
    "body": "Joints without fingers: the reference's left out, ours folded (`--fingers off`)",
    "tree": "Tree on the reference joints, from the reference root",
    "root": "Root among the reference joints", "skin": "Skin on the reference skeleton",
}


def column(characters: list[dict], stage: str, system: str, figure: str) -> np.ndarray:
    """(N,), nan where a character lacks the figure."""
    return np.array([c["figures"].get(stage, {}).get(system, {}).get(figure, np.nan) for c in characters], float)


def mean_with_interval(values: np.ndarray) -> dict | None:
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    return {"count": len(values), "mean": float(values.mean()), "interval": metrics.bootstrap_interval(values)}


def summary(characters: list[dict]) -> dict:
    """Stage -> system -> figure -> mean and interval; below ``differences`` ours minus each baseline, paired."""
    result: dict = {"characters": len(characters), "stages": {}, "differences": {}}
    for stage, systems in SYSTEMS.items():
        figures = FIGURES[stage] + (MULTIPLIED if stage == "joints" else ())
        result["stages"][stage], result["differences"][stage] = {}, {}
        for system in systems:
            columns = {name: column(characters, stage, system, name) for name, *_ in figures}
            means = {name: mean_with_interval(values) for name, values in columns.items()}
            if not any(means.values()):
                continue
            result["stages"][stage][system] = means
            if system != systems[0]:
                result["differences"][stage][system] = {
                    name: mean_with_interval(column(characters, stage, systems[0], name) - values)
                    for name, values in columns.items()}
    return result | {"soundness": soundness(characters)}


def soundness(characters: list[dict]) -> dict:
    ratio = column(characters, "joints", "rigsmith", "joint_ratio")
    result = {
        "failures": sum(len(c["failures"]) for c in characters),
        "joint_ratio_median": {"median": float(np.median(ratio)), "interval": metrics.bootstrap_interval_of_median(ratio)},
    }
    for figure in ("unweighted", "not_finite"):
        result[figure] = float(column(characters, "rig", "rigsmith", figure).sum())
    for figure in ("mirror_error", "root_distance", "by_nearest_bone", "seconds", "fingers_found", "others_found"):
        result[figure] = mean_with_interval(column(characters, "rig", "rigsmith", figure))
    return result


# ---- Markdown -------------------------------------------------------------------------------------------------------


def number(entry: dict | None, factor: float, decimals: int, signed: bool = False) -> str:
    if entry is None:
        return "–"
    style = f"{'+' if signed else ''}.{decimals}f"
    low, high = (format(x * factor, style) for x in entry["interval"])
    return f"{format(entry['mean'] * factor, style)} [{low}, {high}]"


def verdict(entry: dict | None, less_is_better: bool) -> str:
    """Bold where the whole interval of the difference is on the better side, struck where it is on the worse."""
    if entry is None:
        return "–"
    low, high = entry["interval"]
    return "better" if (high < 0 if less_is_better else low > 0) else "worse" if (low > 0 if less_is_better else high < 0) else "open"


def stage_tables(group: dict, stage: str) -> list[str]:
    figures = FIGURES[stage]
    heading = [f"| {' | '.join(['', *(title for _, title, *_ in figures)])} |", "|---" * (len(figures) + 1) + "|"]
    lines = [f"#### {TITLES[stage]}", "", *heading]
    for system, means in group["stages"][stage].items():
        cells = [number(means[name], factor, decimals) for name, _, factor, decimals, _ in figures]
        lines.append(f"| {system} | {' | '.join(cells)} |")
    first = SYSTEMS[stage][0]
    for system, means in group["differences"][stage].items():
        cells = [f"{number(means[name], factor, decimals, True)} {verdict(means[name], less)}"
                 for name, _, factor, decimals, less in figures]
        lines.append(f"| *{first} − {system}* | {' | '.join(cells)} |")
    return [*lines, ""]


def tolerance_table(group: dict) -> list[str]:
    """IoU, precision and recall at half and one and a half times the tolerance."""
    systems = group["stages"]["joints"]
    lines = [f"| {' | '.join(['', *(title for _, title, *_ in MULTIPLIED)])} |", "|---" * (len(MULTIPLIED) + 1) + "|"]
    for system, means in systems.items():
        lines.append(f"| {system} | {' | '.join(number(means[name], 1, 3) for name, *_ in MULTIPLIED)} |")
    return [*lines, ""]


def soundness_lines(group: dict) -> list[str]:
    sound = group["soundness"]
    ratio, fingers = sound["joint_ratio_median"], sound["fingers_found"]
    return [
        f"Failures {sound['failures']}; vertices without weights {sound['unweighted']:.0f}; values that are no numbers "
        f"{sound['not_finite']:.0f}. Predicted / reference joints, median: {ratio['median']:.2f} "
        f"[{ratio['interval'][0]:.2f}, {ratio['interval'][1]:.2f}]. Left/right joint error of characters rigged as symmetric: "
        f"{number(sound['mirror_error'], 100, 3)} % of the longest side"
        + (f" ({sound['mirror_error']['count']} characters)" if sound["mirror_error"] else "")
        + f". Distance of our root from the reference root: {number(sound['root_distance'], 100, 1)} %. "
        f"Seconds a rig (one thread, machine shared): {number(sound['seconds'], 1, 2)}."
        + (f" Where the artist rigged fingers ({fingers['count']} characters), share of their joints found: "
           f"{number(fingers, 1, 2)}; of the other joints there: {number(sound['others_found'], 1, 2)}." if fingers else ""), ""]


def group_text(title: str, group: dict) -> list[str]:
    lines = [f"### {title}: {group['characters']} characters", ""]
    for stage in SYSTEMS:
        lines += stage_tables(group, stage)
        if stage == "joints":
            lines += tolerance_table(group) + soundness_lines(group)
    return lines


def category_table(groups: dict[str, dict]) -> list[str]:
    """One line per category, ours alone."""
    chosen = (("joints", 0), ("joints", 3), ("joints", 4), ("joints", 5), ("tree", 0), ("root", 0), ("skin", 0), ("skin", 2))
    figures = [(stage, *FIGURES[stage][k]) for stage, k in chosen]
    lines = [f"| category | n | {' | '.join(f'{stage}: {title}' for stage, _, title, *_ in figures)} |", "|---" * (len(figures) + 2) + "|"]
    for category, group in groups.items():
        cells = [number(group["stages"][stage].get(SYSTEMS[stage][0], {}).get(name), factor, decimals)
                 for stage, name, _, factor, decimals, _ in figures]
        lines.append(f"| {category} | {group['characters']} | {' | '.join(cells)} |")
    return [*lines, ""]
