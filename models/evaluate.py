"""Judges each shipped network alone on validation characters, and tunes the clustering constants on them.

Whole rigs of the built program are judged by evaluate_rigs.py (`make evaluate`).

    python models/evaluate.py CACHE/val.npz CACHE/val2.npz                 figures into artifacts/manifest.json
    python models/evaluate.py --calibrate CACHE/val.npz CACHE/val2.npz     also picks the clustering constants

Headline: organic characters, that is all but box models. Definitions are in rigsmith_models/evaluation. Needs no PyTorch.
"""

import argparse
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from rigsmith_models.data import read_cache
from rigsmith_models.evaluation import shipped, stages
from rigsmith_models.evaluation.clustering import Clustering, modes_of, shifted
from rigsmith_models.evaluation.metrics import bootstrap_interval

BANDWIDTHS = (0.04, 0.05)
DENSITIES = (0.003, 0.005, 0.007, 0.01)
ATTENTION_POWERS = (1.0, 2.0)
CD_WEIGHT = 2.0
JOINT_RATIOS = (0.8, 1.2)  # predicted / reference joint count that a calibrated setting must keep


def summary(columns: dict[str, np.ndarray], digits: int = 4) -> dict:
    """Mean of every figure, with the bootstrap 95% interval of the mean over characters."""
    return {name: {"mean": round(float(v.mean()), digits), "interval": [round(x, digits) for x in bootstrap_interval(v)]}
            for name, v in columns.items()}


def calibrated(characters, predictions) -> tuple[Clustering, list[dict]]:
    """The best setting among those whose joint count is near the reference's, and the whole grid.

    Best: IoU - CD_WEIGHT x CD-J2J. IoU alone prefers few sure joints.
    """
    grid = []
    for bandwidth, power in itertools.product(BANDWIDTHS, ATTENTION_POWERS):
        shift = replace(Clustering(), bandwidth=bandwidth, attention_power=power)
        clouds = [shifted(c.positions + d, np.linalg.norm(d, axis=1), a, shift) for c, (d, a) in zip(characters, predictions)]
        for density in DENSITIES:
            settings = replace(shift, density_min=density)
            figures = stages.columns([stages.joint_row(c, modes_of(cloud, settings)) for c, cloud in zip(characters, clouds)])
            grid.append({"settings": settings, **{k: float(v.mean()) for k, v in figures.items()}})
    ratio = {id(g): g["joints"] / g["joints_reference"] for g in grid}
    allowed = [g for g in grid if JOINT_RATIOS[0] <= ratio[id(g)] <= JOINT_RATIOS[1]] or grid
    return max(allowed, key=lambda g: g["iou"] - CD_WEIGHT * g["cd_j2j"])["settings"], grid


def calibration_entry(settings: Clustering) -> dict[str, float]:
    return {
        "bandwidth": settings.bandwidth, "mean_shift_steps": settings.steps, "mean_shift_step_length": settings.step_length,
        "attention_min": settings.attention_min, "attention_power": settings.attention_power,
        "mode_density_min": settings.density_min, "suppression_displacement": settings.suppression,
        "middle_max": settings.middle,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("caches", nargs="+", type=Path)
    parser.add_argument("--calibrate", action="store_true")
    arguments = parser.parse_args()
    characters = [c for path in arguments.caches for c in read_cache(path)]
    organic = [c for c in characters if c.meta["style"] != "box"]
    boxes = [c for c in characters if c.meta["style"] == "box"]
    manifest = shipped.manifest()
    networks = shipped.networks()

    predictions = stages.displaced(organic, networks["rignet_displacement"], networks["rignet_attention"])
    settings = shipped.clustering_of(manifest["calibration"])
    if arguments.calibrate:
        settings, grid = calibrated(organic, predictions)
        manifest["calibration"] = calibration_entry(settings)
        manifest["calibration_tuned_on"] = f"{len(organic)} organic validation characters"
        for line in grid:
            print(f"h {line['settings'].bandwidth} density {line['settings'].density_min} power {line['settings'].attention_power}: "
                  f"IoU {line['iou']:.3f} CD {line['cd_j2j']:.4f} joints {line['joints']:.1f} of {line['joints_reference']:.1f}")
    untrained = [(np.zeros_like(d), np.ones_like(a)) for d, a in predictions]
    box_predictions = stages.displaced(boxes, networks["rignet_displacement"], networks["rignet_attention"])
    results = {
        "joints_organic": summary(stages.joint_stage(organic, predictions, settings)),
        "joints_organic_untrained": summary(stages.joint_stage(organic, untrained, settings)),
        "joints_box": summary(stages.joint_stage(boxes, box_predictions, settings)),
        "points_organic": summary(stages.point_figures(organic, predictions)),
        "bone_organic": summary(stages.bone_stage(organic, networks["rignet_bone"])),
        "root_organic": summary(stages.root_stage(organic, networks["rignet_root"])),
        "skin_organic": summary(stages.skin_stage(organic, networks["rignet_skin"])),
        "skin_box": summary(stages.skin_stage(boxes, networks["rignet_skin"])),
    }
    of_network = {
        "rignet_displacement": ("points_organic", "joints_organic", "joints_organic_untrained", "joints_box"),
        "rignet_attention": ("points_organic",), "rignet_bone": ("bone_organic",), "rignet_root": ("root_organic",),
        "rignet_skin": ("skin_organic", "skin_box"),
    }
    for name, keys in of_network.items():
        manifest["networks"][name]["validation"] = {
            "characters": {"organic": len(organic), "box": len(boxes)}, **{key: results[key] for key in keys}}
    shipped.MANIFEST.write_text(json.dumps(manifest, indent=1) + "\n")
    write_ledger(results, networks, characters, settings)
    for key, figures in results.items():
        print(key, "  ".join(f"{n} {f['mean']:.4f} [{f['interval'][0]:.4f}, {f['interval'][1]:.4f}]" for n, f in figures.items()))


LEDGER = Path(__file__).parent / "TRAINING.md"
LEDGER_MARKS = ("<!-- figures of evaluate.py -->", "<!-- end of figures -->")


def write_ledger(results: dict, networks: dict[str, shipped.Network], characters: list, settings: Clustering) -> None:
    """Puts every figure as a table between two marks of TRAINING.md."""
    lines = ["| stage | figure | mean | 95% of the mean |", "|---|---|---|---|"]
    for stage, figures in results.items():
        lines += [f"| {stage} | {name} | {f['mean']:.4f} | {f['interval'][0]:.4f} to {f['interval'][1]:.4f} |" for name, f in figures.items()]
    vertices = np.mean([len(c.positions) for c in characters])
    seconds = ", ".join(f"{name.removeprefix('rignet_')} {np.mean(net.seconds):.3f}" for name, net in networks.items() if net.seconds)
    lines += ["", f"Clustering: {settings}.", "",
              f"CPU seconds of one run at {vertices:.0f} vertices on average, one thread, machine shared with others: {seconds}."]
    before, _, rest = LEDGER.read_text().partition(LEDGER_MARKS[0])
    after = rest.partition(LEDGER_MARKS[1])[2]
    LEDGER.write_text("\n".join([before + LEDGER_MARKS[0], "", *lines, "", LEDGER_MARKS[1] + after]))


if __name__ == "__main__":
    main()
