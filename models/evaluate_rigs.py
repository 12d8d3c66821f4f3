"""Measures the built program on characters that artists rigged: joints, tree, root and skin, beside every baseline.

    make evaluate                                              the validation rigs of the shared data folder
    python models/evaluate_rigs.py --data DATA                 the same
    python models/evaluate_rigs.py --set DATA/rigs/train.npz --count 40
    python models/evaluate_rigs.py --synthetic 900000 --count 24      generated characters that no training run has seen

Writes results.json (every figure of every character), results.md (the tables) and worst-first.png into --output, and with
--publish the tables between two marks of docs/models.md. Every figure is defined in docs/evaluation.md. The hidden test part is
never read. Everything runs at one thread; --processes 2 measures two characters at once.
"""

import argparse
import json
import multiprocessing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rigsmith_models.data.prepare import synthetic_rigs
from rigsmith_models.data.shards import Rig, RigShard
from rigsmith_models.evaluation import baselines, metrics, pictures, shipped, tables
from rigsmith_models.evaluation.measure import SKIN_METHODS, Setting, attempt, measured, official_rig
from rigsmith_models.evaluation.program import Program

REPOSITORY = Path(__file__).resolve().parents[1]
VALIDATION = ("rigs/val.npz", "rigs/val2.npz")
TRAINING = ("rigs/train.npz", "rigs/train2.npz", "rigs/train_box.npz", "rigs/train_makehuman.npz")
BLENDER = Path(__file__).parent / "blender_heat.json"
DOCUMENT = REPOSITORY / "docs" / "models.md"
NETWORK_MARKS = ("<!-- networks of evaluate_rigs.py -->", "<!-- end of networks -->")
MARKS = ("<!-- tables of evaluate_rigs.py -->", "<!-- end of tables -->")
PICTURES = 24


def main() -> None:
    arguments = parsed()
    rigs, described = characters(arguments)
    worker = Worker(arguments.rigsmith, arguments.options, training_shards(arguments.data))
    if arguments.processes > 1:
        with multiprocessing.get_context("fork").Pool(min(arguments.processes, 2)) as pool:
            done = pool.map(worker, rigs, chunksize=1)
    else:
        done = [worker(rig) for rig in rigs]
    results = [result for result, _ in done]
    add_blender(results)
    evaluation = {
        "set": described, "options": arguments.options, "networks": {n: e["sha256"] for n, e in shipped.manifest()["networks"].items()},
        "groups": {name: tables.summary(members) for name, members in groups(results).items()},
        "categories": {name: tables.summary(members) for name, members in categories(results).items()},
        "official": official(arguments.data, worker.setting().program) if arguments.data else {},
        "characters": results,
    }
    arguments.output.mkdir(parents=True, exist_ok=True)
    (arguments.output / "results.json").write_text(json.dumps(evaluation, indent=1) + "\n")
    text = "\n".join(markdown(evaluation))
    (arguments.output / "results.md").write_text(text + "\n")
    ranked = sorted(done, key=lambda pair: pair[0]["figures"]["joints"]["rigsmith"]["iou"])
    pictures.sheet([row for _, row in ranked[:PICTURES]]).save(arguments.output / "worst-first.png", optimize=True)
    if arguments.publish:
        publish({NETWORK_MARKS: network_table(shipped.manifest()), MARKS: text})
    print(text)


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigsmith", type=Path, default=REPOSITORY / "target/release/rigsmith", help="the built program")
    parser.add_argument("--data", type=Path, help="folder of the shared rigs; also holds the nearest-rig baseline's")
    parser.add_argument("--set", type=Path, action="append", default=[], help="a shard of rigs; repeat for more")
    parser.add_argument("--synthetic", type=int, metavar="SEED", help="generated characters from this seed on")
    parser.add_argument("--count", type=int, help="only so many, spread over the set")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--output", type=Path, default=REPOSITORY / "target/evaluation")
    parser.add_argument("--publish", action="store_true", help="also write the tables into docs/models.md")
    parser.add_argument("options", nargs="*", help="after --: handed to `rigsmith rig`")
    arguments = parser.parse_args()
    beside = REPOSITORY.parent / "shared/data"
    if arguments.data is None and beside.is_dir():
        arguments.data = beside
    if not (arguments.set or arguments.synthetic is not None or arguments.data):
        parser.error("name the rigs to measure on: --data FOLDER, --set FILE or --synthetic SEED")
    return arguments


def characters(arguments: argparse.Namespace) -> tuple[list[Rig], str]:
    if arguments.synthetic is not None:
        count = arguments.count or 24
        return synthetic_rigs(arguments.synthetic, count), f"synthetic {arguments.synthetic} to {arguments.synthetic + count - 1}"
    paths = arguments.set or [arguments.data / name for name in VALIDATION]
    shards = [RigShard(path) for path in paths]
    places = [(shard, k) for shard in shards for k in range(len(shard))]
    if arguments.count:
        places = [places[int(k)] for k in np.linspace(0, len(places) - 1, min(arguments.count, len(places)))]
    return [shard[k] for shard, k in places], " + ".join(path.name for path in paths)


def training_shards(data: Path | None) -> list[Path]:
    return [data / name for name in TRAINING if data and (data / name).exists()]


@dataclass
class Worker:
    """Measures one character; what it needs is opened once per process."""

    program: Path
    options: list[str]
    training: list[Path]
    _setting: Setting | None = None

    def setting(self) -> Setting:
        if self._setting is None:
            self._setting = Setting(
                Program(self.program, self.options), shipped.networks(), shipped.clustering_of(shipped.manifest()["calibration"]),
                baselines.NearestRig([RigShard(path) for path in self.training]) if self.training else None)
        return self._setting

    def __call__(self, rig: Rig):
        result, made, weights = measured(rig, self.setting())
        ours, name = result.figures["joints"]["rigsmith"], result.meta["name"]
        caption = (f"{name} ({result.meta['category']})  IoU {ours['iou']:.2f}  CD-J2J {100 * ours['cd_j2j']:.1f}%  "
                   f"{len(made.joints)} joints for {len(rig.joints)}  skin L1 {result.figures['skin'][SKIN_METHODS[0]]['l1']:.2f}")
        parents = rig.parents.astype(int)
        row = pictures.row(rig.vertices.astype(float), rig.faces, (rig.joints.astype(float), parents, rig.weights),
                           (made.joints, made.parents), weights, caption)
        print(caption, *result.failures, flush=True)
        return result.as_json(), row


def add_blender(results: list[dict]) -> None:
    """Figures that were measured with Blender beforehand, see blender_heat.py."""
    known = json.loads(BLENDER.read_text())["characters"] if BLENDER.exists() else {}
    for result in results:
        if result["meta"]["id"] in known:
            result["figures"]["skin"]["blender_heat"] = known[result["meta"]["id"]]


def groups(results: list[dict]) -> dict[str, list[dict]]:
    organic = [r for r in results if r["meta"]["style"] != "box"]
    boxes = [r for r in results if r["meta"]["style"] == "box"]
    return {name: members for name, members in (("organic", organic), ("box", boxes), ("all", results)) if members}


def categories(results: list[dict]) -> dict[str, list[dict]]:
    members: dict[str, list[dict]] = {}
    for result in results:
        style = "box " if result["meta"]["style"] == "box" else ""
        members.setdefault(style + result["meta"]["category"], []).append(result)
    return dict(sorted(members.items()))


def official(data: Path, program: Program) -> dict[str, dict]:
    """Our joints against those that RigNet's authors published for three meshes; no reference, only a comparison."""
    found = {}
    for mesh in sorted((data / "golden").glob("*_ori.obj")):
        vertices, faces = read_obj(mesh)
        low, side = vertices.min(0), np.ptp(vertices, axis=0).max()
        joints, parents = official_rig(mesh.with_name(mesh.stem + "_rig.txt"))
        noted = type("Noted", (), {"failures": []})()
        made = attempt(lambda: program.rig(vertices, faces), vertices, "rig", noted)
        ours, theirs = (made.joints - low) / side, (joints - low) / side
        found[mesh.stem.removesuffix("_ori")] = {
            "joints": len(ours), "joints_official": len(theirs), "cd_j2j": metrics.joint_to_joint(ours, theirs),
            "cd_b2b": metrics.bone_to_bone(ours, made.parents, theirs, parents), "failures": noted.failures,
        }
    return found


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a plain OBJ file; polygons become fans."""
    vertices, faces = [], []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(x) for x in words[1:4]])
        elif words[:1] == ["f"]:
            corners = [int(word.split("/")[0]) - 1 for word in words[1:]]
            faces += [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]
    return np.array(vertices), np.array(faces)


def markdown(evaluation: dict) -> list[str]:
    lines = [
        f"Set: {evaluation['set']}, {len(evaluation['characters'])} characters; options: "
        f"{' '.join(evaluation['options']) or 'defaults'}. Every cell is a mean and its 95 % bootstrap interval over characters; "
        "rows in italics are paired differences, with *better* or *worse* where the interval excludes 0, else *open*. "
        "Definitions: [evaluation.md](evaluation.md).", ""]
    for name, group in evaluation["groups"].items():
        lines += tables.group_text(name.capitalize(), group)
    lines += ["### By category", "", *tables.category_table(evaluation["categories"])]
    if evaluation["official"]:
        lines += ["### RigNet's published rigs of three meshes, against ours", "",
                  "| mesh | joints, ours / theirs | CD-J2J % | CD-B2B % |", "|---|---|---|---|"]
        lines += [f"| {name} | {e['joints']} / {e['joints_official']} | {100 * e['cd_j2j']:.2f} | {100 * e['cd_b2b']:.2f} |"
                  for name, e in evaluation["official"].items()]
        lines.append("")
    refused = [f"{c['meta']['name']}: {failure}" for c in evaluation["characters"] for failure in c["failures"]]
    return lines + (["### Refused", "", *(f"- {line}" for line in refused), ""] if refused else [])


def network_table(manifest: dict) -> str:
    """What the manifest says of each file's training."""
    lines = ["| network | width | parameters | file | steps (characters seen) | minutes | trained on |", "|---|---|---|---|---|---|---|"]
    for name, entry in manifest["networks"].items():
        runs = [entry["training"]]
        while earlier := runs[0].get("after"):
            runs.insert(0, earlier)
        last = runs[-1]["data"][-1]["characters"]
        ours = sum(count for part, count in last.items() if part.startswith("synthetic"))
        rigs = ", ".join(f"{part} {count}" for part, count in last.items() if not part.startswith("synthetic"))
        steps = " + ".join(f"{run['steps']:,} ({run['passes']:,})" for run in runs)
        minutes = " + ".join(f"{run['cpu_minutes']:.0f} ({run['data'][-1].get('device', 'cpu')})" for run in runs)
        lines.append(f"| {name} | {entry['width']} | {entry['parameters']:,} | {entry['bytes'] / 2**20:.1f} MiB | {steps} | {minutes} | "
                     f"{rigs}; generated {ours} |")
    return "\n".join([*lines, "", "The last data of each run; the manifest lists earlier ones. Parts are shards of openly licensed rigs.", ""])


def publish(sections: dict[tuple[str, str], str]) -> None:
    """Puts each text between its two marks of docs/models.md."""
    document = DOCUMENT.read_text()
    for (begin, end), text in sections.items():
        before, _, rest = document.partition(begin)
        document = "\n".join([before + begin, "", text, end + rest.partition(end)[2]])
    DOCUMENT.write_text(document)


if __name__ == "__main__":
    main()
